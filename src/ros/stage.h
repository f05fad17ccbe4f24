#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <nodelet/nodelet.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <array>
#include <atomic>
#include <boost/circular_buffer.hpp>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "ros/conversions.h"
#include "ros/live_settings.h"
#include "ros/parameters.h"
#include "ros/worker.h"
#include "semantic_topo_loop/FrameDone.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/ros/messages.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop {

/// Counters of one stage for its diagnostics. Thread-safe.
class StageStatistics {
 public:
  using Clock = std::chrono::steady_clock;

  /// A look at the counters; rates are since the previous look.
  struct Snapshot {
    std::map<std::string, double> input_rates_hz;
    double processed_hz = 0.0;
    std::uint64_t processed = 0;
    std::map<std::string, std::uint64_t> counters;
    std::map<std::string, std::string> texts;
    double latency_p50_ms = 0.0, latency_p95_ms = 0.0;  ///< of the last 512 frames
    std::vector<std::string> warnings;                  ///< that hold now
    std::string failure;                                ///< empty while the stage works
  };

  void count_input(const std::string& topic) {
    const std::lock_guard<std::mutex> lock(mutex_);
    ++inputs_[topic];
  }
  void count_processed(Clock::time_point arrival);
  /// Adds to a named counter ("incomplete frames"), which is shown even while it is zero once declared.
  /// @return what it counts now
  std::uint64_t count(const std::string& counter, std::uint64_t n = 1) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return counters_[counter] += n;
  }
  /// Sets a named counter that somebody else counts.
  void set(const std::string& counter, std::uint64_t value) {
    const std::lock_guard<std::mutex> lock(mutex_);
    counters_[counter] = value;
  }
  /// As `count`, of what is lost: a warning for the next 10 s.
  void count_lost(const std::string& counter, std::uint64_t n = 1) {
    const std::lock_guard<std::mutex> lock(mutex_);
    counters_[counter] += n;
    last_loss_ = Clock::now();
  }
  /// As `set`, of what is lost: a warning for the next 10 s if it has grown.
  void set_lost(const std::string& counter, std::uint64_t value) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (value > counters_[counter]) last_loss_ = Clock::now();
    counters_[counter] = value;
  }
  /// Sets a named value that is no count.
  void set_text(const std::string& name, const std::string& text) {
    const std::lock_guard<std::mutex> lock(mutex_);
    texts_[name] = text;
  }
  /// @param warning what is wrong now; empty: nothing   @return whether that has just begun
  bool set_warning(const std::string& subject, const std::string& warning) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return std::exchange(warnings_[subject], warning).empty() && !warning.empty();
  }
  /// @param failure why something does not work; empty: it does
  void set_failure(const std::string& subject, const std::string& failure) {
    const std::lock_guard<std::mutex> lock(mutex_);
    failures_[subject] = failure;
  }
  Snapshot take_snapshot(Clock::time_point now = Clock::now());

 private:
  std::mutex mutex_;  ///< guards all below
  std::map<std::string, std::uint64_t> inputs_, inputs_before_;
  std::map<std::string, std::uint64_t> counters_;
  std::map<std::string, std::string> texts_;
  std::uint64_t processed_ = 0, processed_before_ = 0;
  boost::circular_buffer<double> latencies_ms_{512};  ///< of the last frames: some 17 s at 30 Hz
  std::optional<Clock::time_point> last_loss_;
  std::map<std::string, std::string> warnings_, failures_;  ///< by what they are about
  Clock::time_point last_snapshot_ = Clock::now();
};

/// Publishes something costly only when somebody listens and has not seen it. Not thread-safe.
class LazyPublisher {
 public:
  template <class Message>
  void open(ros::NodeHandle node, const std::string& topic, std::size_t queue_size) {
    publisher_ = node.advertise<Message>(topic, static_cast<std::uint32_t>(queue_size),
                                         [changed = changed_](const auto&) { *changed = true; });
  }
  bool has_listeners() const { return publisher_.getNumSubscribers() > 0; }
  void mark_changed() { *changed_ = true; }
  /// Somebody listens, and the content changed or a listener came since the last publish.
  bool is_due() const { return has_listeners() && *changed_; }
  template <class MessagePtr>
  void publish(const MessagePtr& message) {
    *changed_ = false;
    publisher_.publish(message);
  }

 private:
  ros::Publisher publisher_;
  /// Since the last publish, the content or who listens. Shared: a callback may outlive this.
  std::shared_ptr<std::atomic<bool>> changed_ = std::make_shared<std::atomic<bool>>(false);
};

/// A callback queue with a thread of its own: for what may wait, and for what must not wait for others.
struct CallbackThread {
  CallbackThread() : spinner(1, &queue) { spinner.start(); }

  ros::CallbackQueue queue;
  ros::AsyncSpinner spinner;
};

/// Of these topics each frame has its message, in order, or one of each phase.
template <class Message>
constexpr bool is_for_each_frame =
    std::is_same_v<Message, FrameMessage> || std::is_same_v<Message, DetectionsMessage> ||
    std::is_same_v<Message, AssociationsMessage> || std::is_same_v<Message, MapUpdateMessage> ||
    std::is_same_v<Message, LoopsMessage> || std::is_same_v<Message, CorrectionMessage>;

/// What the nodelets share: strict parameters, a worker, sessions, diagnostics, and an order of destruction that makes
/// unloading safe at any time. Callbacks only push to the worker; everything a stage overrides or hands to `subscribe`
/// runs on the worker's one thread, so that a stage needs no lock. Messages come on a thread of
/// their own, and so do timers and services, which may wait.
///
/// A derived class calls `start` first in onInit, then advertises, subscribes and follows the sessions, which lets the
/// worker begin; its destructor calls `stop`.
class Stage : public nodelet::Nodelet {
 protected:
  /// @param name as in acknowledgements and FrameDone, e.g. "ObjectAssociation"
  explicit Stage(std::string name) : name_(std::move(name)) {}
  ~Stage() override { stop(); }

  /// Loads the parameters, and the classes where the stage has some, and starts worker and diagnostics. A bad parameter
  /// or file is one FATAL line and an error in the diagnostics; the nodelet stays inert and the manager lives.
  /// @param inputs messages a frame brings to this stage
  template <class Own>
  bool start(core::Options* options, Own* own, std::size_t inputs) {
    using Parameters = core::Result<NodeletParameters<Own>>;
    core::Result<core::OptionTexts> texts = read_parameters(getPrivateNodeHandle());
    const Parameters parameters = texts ? make_nodelet_parameters<Own>(*std::move(texts)) : Parameters(texts.error());
    if (parameters) start_worker(parameters->own.queue_size, inputs);
    start_diagnostics();
    if (!parameters) return fail(parameters.message());
    *options = parameters->options;
    *own = parameters->own;
    if constexpr (std::is_base_of_v<ClassStageParameters, Own>) return load_classes(own->class_table);
    return true;
  }
  /// The nodelet cannot work: says so once, and in the diagnostics from then on. @return false
  bool fail(const std::string& error);
  /// Counts something that is wrong with the input, and warns at the first time.
  void complain(const std::string& cause, const std::string& detail);
  /// Of the stages whose parameters are ClassStageParameters; never null there.
  const std::shared_ptr<const core::ClassTable>& classes() const { return classes_; }
  /// Warns when something begins to be wrong, and in the diagnostics for as long as it is. Thread-safe.
  /// @param warning what is wrong now; empty: nothing   @return whether it has just begun
  bool warn_while(const std::string& subject, const std::string& warning);
  /// Shuts down what brings work, closes the queue and joins the thread. May be called twice.
  void stop();

  /// Follows session_control: START of a session calls `reset_session`; every command is acknowledged. Call it last in
  /// onInit: who hears the acknowledgement takes the stage for ready.
  void follow_sessions();
  /// Lets the worker begin with what has been pushed.
  void open_queue() { worker_->start(); }
  /// Has something saved when the nodelet is unloaded, or as soon as ROS shuts down: other nodelets of the manager may
  /// take longer to end than roslaunch waits. @param save called once at most, on a thread of its own
  void save_at_end(std::function<void()> save);
  /// @param unsaved there is something that save_at_end has to save. Thread-safe
  void set_unsaved(bool unsaved) { is_unsaved_ = unsaved; }
  /// A new session has begun: forget everything, and take over what `session_map` gives.
  virtual void reset_session() {}
  /// From now on the map is fixed, or grows again.
  virtual void set_localization(bool /*localization*/) {}
  /// As the front end said last.
  const SessionControl& session() const { return *session_; }
  /// For reset_session, of stages with classes: the map that the session goes on with, of which this stage needs these
  /// parts.   @return null: there is none, the map is frozen, or fail() was called
  std::shared_ptr<const core::MapState> session_map(core::MapParts parts);

  /// Messages of the current session reach `handler`; those of another one are dropped and counted.
  template <class Message, class Derived>
  void subscribe(const std::string& topic, Keep keep,
                 void (Derived::*handler)(const boost::shared_ptr<const Message>&)) {
    keep_subscriber(make_subscriber<Message>(topic, keep, handler));
  }
  /// Messages that belong to no session.
  template <class Message, class Derived>
  ros::Subscriber listen(const std::string& topic, Keep keep, std::uint32_t queue_size,
                         void (Derived::*handler)(const boost::shared_ptr<const Message>&)) {
    using ConstPtr = boost::shared_ptr<const Message>;
    const boost::function<void(const ConstPtr&)> callback = [this, topic, keep, handler](const ConstPtr& message) {
      push(topic, keep, [this, message, handler] { (static_cast<Derived*>(this)->*handler)(message); });
    };
    keep_subscriber(subscriber_node().template subscribe<Message>(topic, queue_size, callback));
    return subscribers_.back();
  }
  /// For every subscription. A nodelet's own queue is shut during onInit: of a topic whose latched message comes by
  /// then, each message would be delivered when the next one comes.
  ros::NodeHandle subscriber_node() {
    ros::NodeHandle node(getNodeHandle());
    node.setCallbackQueue(&message_thread_.queue);
    return node;
  }
  /// As `subscribe`, while wanted, and only then.
  template <class Message, class Derived>
  void toggle(bool wanted, const std::string& topic, Keep keep,
              void (Derived::*handler)(const boost::shared_ptr<const Message>&), ros::Subscriber* subscriber) {
    if (wanted && !*subscriber) *subscriber = make_subscriber(topic, keep, handler);
    if (!wanted && *subscriber) subscriber->shutdown();
  }
  /// Counts an arrival on `topic` and queues the task.
  void push(const std::string& topic, Keep keep, Worker::Task task);
  /// Shut down by `stop` before the worker ends.
  void keep_subscriber(const ros::Subscriber& subscriber) { subscribers_.push_back(subscriber); }
  /// A service in the nodelet's own namespace.
  template <class Request, class Response>
  void serve(const std::string& service, const boost::function<bool(Request&, Response&)>& handler) {
    if (!service_thread_) service_thread_ = std::make_unique<CallbackThread>();
    ros::NodeHandle node(getPrivateNodeHandle());
    node.setCallbackQueue(&service_thread_->queue);
    services_.push_back(node.advertiseService(service, handler));
  }
  template <class Derived, class Request, class Response>
  void serve(const std::string& service, bool (Derived::*handler)(Request&, Response&)) {
    serve<Request, Response>(service, [this, handler](Request& request, Response& response) {
      return (static_cast<Derived*>(this)->*handler)(request, response);
    });
  }
  /// For services that ask what the worker owns: waits for its answer.
  /// @return nullopt if none comes in time: it is busy for longer, or ends
  template <class Question>
  auto ask(const std::string& service, Question question) {
    using Answer = decltype(question());
    constexpr std::chrono::seconds kPatience(2);  // some solves of a large graph
    const auto answer = std::make_shared<std::promise<Answer>>();
    std::future<Answer> future = answer->get_future();
    push(service, Keep::kPinned, [answer, question] { answer->set_value(question()); });
    if (future.wait_for(kPatience) != std::future_status::ready) return std::optional<Answer>();
    return std::optional<Answer>(future.get());
  }
  /// A std_srvs/Trigger that answers what `act` gives back.
  void serve_trigger(const std::string& service, const std::function<core::Result<std::string>()>& act);
  /// Lets dynamic_reconfigure's tools see and change the live fields of an options struct.
  /// @param options the worker's alone from now on   @param take_over runs there, between two frames, once they changed
  template <class Struct>
  void serve_settings(Struct* options, const Worker::Task& take_over) {
    struct Wanted {
      std::mutex mutex;  ///< guards the options, which the services' thread alone changes
      Struct options;
    };
    const auto wanted = std::make_shared<Wanted>();
    wanted->options = *options;
    const std::function<void()> apply = once_in_queue([wanted, options, take_over] {
      {
        const std::lock_guard<std::mutex> lock(wanted->mutex);
        *options = wanted->options;
      }
      take_over();
    });
    const auto change = [wanted, apply](const core::OptionTexts& texts) {
      {
        const std::lock_guard<std::mutex> lock(wanted->mutex);
        if (const core::Status status = core::change_options(texts, &wanted->options); !status) return status;
      }
      apply();
      return core::Status();
    };
    serve_settings(
        core::list_options<Struct>(), [wanted] { return core::list_options(wanted->options); }, change);
  }
  /// For other services that change one of them; call it on the services' thread. A refusal is told and counted.
  core::Status change_settings(const core::OptionTexts& texts);
  /// Calls the task each `period_s` of wall time; shut down as a subscriber. Not on the nodelet's own queue: to stop a
  /// timer does not wait for its task, to stop the thread does.
  /// @param thread where; null: that of the timers
  void keep_timer(double period_s, const std::function<void()>& task, CallbackThread* thread = nullptr);
  /// @return what queues the task, unless it waits there already
  std::function<void()> once_in_queue(const Worker::Task& task);
  /// Runs the task on the worker each `period_s` of wall time; a tick is left out while the last one still waits.
  void start_timer(double period_s, const Worker::Task& task);
  template <class Message>
  ros::Publisher advertise(const std::string& topic, bool latch = false) {
    return getNodeHandle().template advertise<Message>(topic, queue_size_, latch);
  }

  /// Says a value of the core about the current session.
  template <class Message>
  void publish(const ros::Publisher& publisher, const std_msgs::Header& header, typename Message::Value value) const {
    publisher.publish(boost::make_shared<Message>(header, session_id_, std::move(value)));
  }

  /// @param frame_id -1: the image gave no frame
  void publish_done(const ros::Publisher& publisher, const ros::Time& stamp, std::int64_t frame_id, std::uint8_t status,
                    std::uint64_t map_version = 0) const;
  /// Who counts the frames of a run in lockstep from outside is waited for by nobody.
  ros::Publisher advertise_done() {
    return getNodeHandle().advertise<FrameDone>("frame_done", kRoomForState * queue_size_);
  }

  /// Has something written where a user wants it. @param write takes the absolute path and returns a Status
  /// @return the absolute path, or the error
  template <class Write>
  static core::Result<std::string> write_to(const std::string& path, const Write& write) {
    std::error_code error_code;
    const std::filesystem::path absolute = std::filesystem::absolute(path, error_code);
    if (error_code) return core::Error{path + ": " + error_code.message()};
    if (const core::Status written = write(absolute.string()); !written) return written.error();
    return absolute.lexically_normal().string();
  }
  /// The place that a service's caller names. @param path relative to the directory, or absolute   @param anywhere
  /// it may lie elsewhere   @return an error, with path and directory, if it does not lie below, all links followed
  static core::Result<std::string> path_below(const std::string& directory, const std::string& path, bool anywhere);
  /// Says where something was written, or why not, which is a failure of the stage until that is written. @return
  /// whether it was
  bool report_written(const std::string& what, const core::Result<std::string>& written);
  /// A service's success and message.
  template <class Response>
  static void answer(const core::Result<std::string>& result, Response* response) {
    response->success = static_cast<bool>(result);
    response->message = result ? *result : result.message();
  }

  /// Call when a frame has gone through: latency is counted from the arrival of the task that runs.
  void count_processed() { statistics_.count_processed(task_arrival_); }
  /// When what is worked on arrived.
  StageStatistics::Clock::time_point task_arrival() const { return task_arrival_; }
  StageStatistics& statistics() { return statistics_; }
  const std::string& name() const { return name_; }
  /// On the worker's thread only; 0 before the first session.
  std::uint32_t session_id() const { return session_id_; }
  /// For the owner of the session, who does not follow it.
  void set_session(std::uint32_t session_id) { session_id_ = session_id; }
  std::size_t queue_capacity() const { return queue_size_; }

 private:
  /// Of a topic with a message for each frame: what came last, of one phase.
  struct Sequence {
    std::uint32_t session_id = 0;
    std::int64_t frame_id = 0;
  };
  template <class Message, class Derived>
  ros::Subscriber make_subscriber(const std::string& topic, Keep keep,
                                  void (Derived::*handler)(const boost::shared_ptr<const Message>&)) {
    using ConstPtr = boost::shared_ptr<const Message>;
    const boost::function<void(const ConstPtr&)> callback =
        [this, topic, keep, handler, last = std::array<Sequence, 2>()](const ConstPtr& message) mutable {
          Keep own_keep = keep;
          if constexpr (is_for_each_frame<Message>) {
            std::size_t phase = 0;  // a frame's correction may come after the next ones' observations
            if constexpr (std::is_same_v<Message, MapUpdateMessage>)
              phase = message->phase == core::MapUpdatePhase::kObservation ? 0 : 1;
            count_missed(topic, {message->session_id, message->frame_id}, &last[phase]);
          }
          if constexpr (std::is_same_v<Message, FrameMessage>) own_keep = message->is_end ? Keep::kPinned : keep;
          push(topic, own_keep, [this, message, handler] {
            if (is_current(message->session_id)) (static_cast<Derived*>(this)->*handler)(message);
          });
        };
    // The recorder of a run in lockstep is waited for by nobody, and may be a tenth of a second behind at any time.
    const std::uint32_t room = keep == Keep::kDroppable ? queue_size_ : kRoomForState * queue_size_;
    return subscriber_node().template subscribe<Message>(topic, room, callback);
  }
  /// roscpp's own queue drops without a word: a frame that is left out of the sequence tells.
  void count_missed(const std::string& topic, const Sequence& next, Sequence* last);
  void serve_settings(const std::vector<core::OptionRow>& defaults, LiveSettings::Rows rows,
                      LiveSettings::Change change);
  void note_refusal(const core::Status& changed);
  void start_diagnostics();
  void start_worker(int queue_size, std::size_t inputs);
  /// @return false after fail()
  bool load_classes(const std::string& path);
  void report(diagnostic_updater::DiagnosticStatusWrapper& status);
  bool is_current(std::uint32_t session_id);
  void handle_session(const SessionControl::ConstPtr& control);

  const std::string name_;
  std::uint32_t queue_size_ = 1;
  std::shared_ptr<const core::ClassTable> classes_;
  std::uint32_t session_id_ = 0;  ///< worker thread only
  ros::Time session_stamp_;       ///< of the START that began it; worker thread only
  SessionControl::ConstPtr session_ = boost::make_shared<SessionControl>();  ///< worker thread only
  StageStatistics::Clock::time_point task_arrival_{};                        ///< worker thread only
  StageStatistics statistics_;
  std::unique_ptr<diagnostic_updater::Updater> updater_;
  ros::Publisher ack_publisher_, working_publisher_;
  CallbackThread message_thread_;  ///< outlives the subscriptions
  CallbackThread timer_thread_;    ///< the diagnostics ask the master now and then: no message shall wait for that
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  std::unique_ptr<LiveSettings> settings_;  ///< services' thread only, once they are served
  std::vector<ros::WallTimer> timers_;
  std::unique_ptr<CallbackThread> service_thread_;
  std::unique_ptr<Worker> worker_;
  std::promise<void> stopped_;  ///< of what save_at_end waits for
  std::atomic<bool> is_unsaved_{false};
  std::thread saver_;
};

/// A stage with the options of the core and its own parameters.   @tparam Base Stage, or what is derived from it
template <class Own, class Base = Stage>
class StageWith : public Base {
 protected:
  explicit StageWith(std::string name) : Base(std::move(name)) {}
  bool start(std::size_t inputs) { return Base::start(&options_, &parameters_, inputs); }

  core::Options options_;
  Own parameters_;
};

}  // namespace semantic_topo_loop
