#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <nodelet/nodelet.h>
#include <ros/ros.h>

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "ros/conversions.h"
#include "ros/parameters.h"
#include "ros/stage_statistics.h"
#include "ros/worker.h"
#include "semantic_topo_loop/SessionAck.h"
#include "semantic_topo_loop/SessionControl.h"
#include "semantic_topo_loop/ros/messages.h"
#include "semantic_topo_loop/types/class_table.h"

namespace semantic_topo_loop {

/// What the nodelets share: strict parameters, a worker, sessions, diagnostics, and an order of destruction that makes
/// unloading safe at any time. Callbacks only push to the worker; everything a stage overrides or hands to `subscribe`
/// runs on the worker's one thread, so that a stage needs no lock.
///
/// A derived class calls `start` first in onInit, then advertises, subscribes and follows the sessions; its destructor
/// calls `stop`.
class Stage : public nodelet::Nodelet {
 protected:
  /// @param name as in acknowledgements and FrameDone, e.g. "ObjectAssociation"
  explicit Stage(std::string name) : name_(std::move(name)) {}
  ~Stage() override { stop(); }

  /// Loads the parameters and starts worker and diagnostics. A bad parameter is one FATAL line and an error in the
  /// diagnostics; the nodelet stays inert and the manager lives.
  /// @param inputs messages a frame brings to this stage
  template <class Own>
  bool start(core::Options* options, Own* own, std::size_t inputs) {
    const core::Result<NodeletParameters<Own>> parameters = load_parameters<Own>(getPrivateNodeHandle());
    start_diagnostics();
    if (!parameters) {
      fail(parameters.message());
      return false;
    }
    *options = parameters->options;
    *own = parameters->own;
    start_worker(own->queue_size, inputs);
    return true;
  }
  /// The nodelet cannot work: says so once, and in the diagnostics from then on.
  void fail(const std::string& error);
  /// Counts something that is wrong with the input, and warns at the first time.
  void complain(const std::string& cause, const std::string& detail);
  /// @return null after fail() if the file cannot be used
  std::shared_ptr<const core::ClassTable> load_classes(const std::string& path);
  /// Shuts down what brings work, closes the queue and joins the thread. May be called twice.
  void stop();

  /// Follows session_control: START of a session calls `reset_session`; every command is acknowledged. Call it last in
  /// onInit: who hears the acknowledgement takes the stage for ready.
  void follow_sessions();
  /// A new session has begun: forget everything.
  virtual void reset_session() {}
  /// Adds a stage's own figures to its diagnostics. Called on the callback thread: read atomics or lock.
  virtual void add_diagnostics(diagnostic_updater::DiagnosticStatusWrapper&) {}

  /// Messages of the current session reach `handler`; those of another one are dropped and counted.
  template <class Message, class Derived>
  void subscribe(const std::string& topic, Keep keep,
                 void (Derived::*handler)(const boost::shared_ptr<const Message>&)) {
    keep_subscriber(make_subscriber<Message>(topic, keep, handler));
  }
  /// The same, for a subscription that the stage opens and closes itself.
  template <class Message, class Derived>
  ros::Subscriber make_subscriber(const std::string& topic, Keep keep,
                                  void (Derived::*handler)(const boost::shared_ptr<const Message>&)) {
    using ConstPtr = boost::shared_ptr<const Message>;
    const boost::function<void(const ConstPtr&)> callback = [this, topic, keep, handler](const ConstPtr& message) {
      push(topic, keep, [this, message, handler] {
        if (is_current(message->session_id)) (static_cast<Derived*>(this)->*handler)(message);
      });
    };
    return getNodeHandle().template subscribe<Message>(topic, queue_size_, callback);
  }
  /// Counts an arrival on `topic` and queues the task.
  void push(const std::string& topic, Keep keep, Worker::Task task);
  /// Shut down by `stop` before the worker ends.
  void keep_subscriber(const ros::Subscriber& subscriber) { subscribers_.push_back(subscriber); }
  void keep_service(const ros::ServiceServer& service) { services_.push_back(service); }
  void keep_timer(const ros::WallTimer& timer) { timers_.push_back(timer); }
  /// Runs the task on the worker each `period_s` of wall time; a tick is left out while the last one still waits.
  void start_timer(double period_s, Worker::Task task);
  template <class Message>
  ros::Publisher advertise(const std::string& topic, bool latch = false) {
    return getNodeHandle().template advertise<Message>(topic, queue_size_, latch);
  }

  /// Says a value of the core about the current session.
  template <class Message>
  void publish(const ros::Publisher& publisher, const std_msgs::Header& header, typename Message::Value value) const {
    publisher.publish(boost::make_shared<Message>(header, session_id_, std::move(value)));
  }

  /// Call when a frame has gone through: latency is counted from the arrival of the task that runs.
  void count_processed() { statistics_.count_processed(task_arrival_); }
  StageStatistics& statistics() { return statistics_; }
  const std::string& name() const { return name_; }
  /// On the worker's thread only; 0 before the first session.
  std::uint32_t session_id() const { return session_id_; }
  /// For the owner of the session, who does not follow it.
  void set_session(std::uint32_t session_id) { session_id_ = session_id; }
  std::size_t queue_capacity() const { return queue_size_; }

 private:
  void start_diagnostics();
  void start_worker(int queue_size, std::size_t inputs);
  void report(diagnostic_updater::DiagnosticStatusWrapper& status);
  bool is_current(std::uint32_t session_id);
  void handle_session(const SessionControl& control);

  const std::string name_;
  std::uint32_t queue_size_ = 1;
  std::uint32_t session_id_ = 0;                       ///< worker thread only
  ros::Time session_stamp_;                            ///< of the START that began it; worker thread only
  StageStatistics::Clock::time_point task_arrival_{};  ///< worker thread only
  StageStatistics statistics_;
  std::unique_ptr<diagnostic_updater::Updater> updater_;
  ros::WallTimer diagnostics_timer_;
  ros::Publisher ack_publisher_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  std::vector<ros::WallTimer> timers_;
  std::unique_ptr<Worker> worker_;
};

}  // namespace semantic_topo_loop
