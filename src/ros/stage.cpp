#include "ros/stage.h"

#include <dynamic_reconfigure/Reconfigure.h>
#include <std_msgs/String.h>
#include <std_srvs/Trigger.h>

#include <algorithm>

#include "geometry/statistics.h"
#include "io/process_memory.h"
#include "pipeline/map_state.h"
#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop {
namespace {

constexpr char kOtherSession[] = "dropped, other session";
constexpr char kQueueFull[] = "dropped, queue full";
const std::string kMissed = "never arrived: ";
constexpr char kErrors[] = "errors";
constexpr char kSettingsRefused[] = "settings refused";
constexpr double kDiagnosticsPeriodS = 1.0;     ///< diagnostic_updater's own
constexpr double kErrorLogPeriodS = 5.0;        ///< an error a frame must not flood the log
constexpr std::chrono::seconds kLossShown(10);  ///< long enough to be seen, and soon over

}  // namespace

void StageStatistics::count_processed(Clock::time_point arrival) {
  const double latency_ms = std::chrono::duration<double, std::milli>(Clock::now() - arrival).count();
  const std::lock_guard<std::mutex> lock(mutex_);
  ++processed_;
  latencies_ms_.push_back(latency_ms);
}

StageStatistics::Snapshot StageStatistics::take_snapshot(Clock::time_point now) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const double elapsed_s = std::max(1e-3, std::chrono::duration<double>(now - last_snapshot_).count());
  Snapshot snapshot;
  for (const auto& [topic, n] : inputs_) {
    snapshot.input_rates_hz[topic] = static_cast<double>(n - inputs_before_[topic]) / elapsed_s;
  }
  snapshot.processed = processed_;
  snapshot.processed_hz = static_cast<double>(processed_ - processed_before_) / elapsed_s;
  snapshot.counters = counters_;
  snapshot.texts = texts_;
  snapshot.latency_p50_ms = core::quantile({latencies_ms_.begin(), latencies_ms_.end()}, 0.50);
  snapshot.latency_p95_ms = core::quantile({latencies_ms_.begin(), latencies_ms_.end()}, 0.95);
  if (last_loss_ && now - *last_loss_ < kLossShown) snapshot.warnings.emplace_back("frames were lost");
  for (const auto& [subject, warning] : warnings_) {
    if (!warning.empty()) snapshot.warnings.push_back(warning);
  }
  for (const auto& [subject, failure] : failures_) {
    if (!failure.empty()) snapshot.failure += (snapshot.failure.empty() ? "" : "; ") + failure;
  }
  inputs_before_ = inputs_;
  processed_before_ = processed_;
  last_snapshot_ = now;
  return snapshot;
}

bool Stage::fail(const std::string& error) {
  NODELET_FATAL("%s is not working: %s", name_.c_str(), error.c_str());
  statistics_.set_failure(name_, error);
  return false;
}

bool Stage::report_written(const std::string& what, const core::Result<std::string>& written) {
  statistics_.set_failure(what, written.message());
  if (written) NODELET_INFO("%s written to %s", what.c_str(), written->c_str());
  if (!written) NODELET_ERROR("%s not written: %s", what.c_str(), written.message().c_str());
  return static_cast<bool>(written);
}

bool Stage::load_classes(const std::string& path) {
  core::Result<core::ClassTable> classes = core::read_class_table(path);
  if (!classes) return fail(classes.message());
  classes_ = std::make_shared<const core::ClassTable>(std::move(*classes));
  return true;
}

void Stage::complain(const std::string& cause, const std::string& detail) {
  if (statistics_.count(cause) > 1) return;
  NODELET_WARN("%s: %s (further ones are counted in the diagnostics)", cause.c_str(), detail.c_str());
}

bool Stage::warn_while(const std::string& subject, const std::string& warning) {
  const bool has_begun = statistics_.set_warning(subject, warning);
  if (has_begun) NODELET_WARN("%s", warning.c_str());
  return has_begun;
}

void Stage::stop() {
  for (ros::Subscriber& subscriber : subscribers_) subscriber.shutdown();
  for (ros::ServiceServer& service : services_) service.shutdown();
  for (ros::WallTimer& timer : timers_) timer.stop();
  service_thread_.reset();
  timer_thread_.spinner.stop();
  message_thread_.spinner.stop();
  if (worker_) worker_->close();
  if (saver_.joinable()) {
    stopped_.set_value();
    saver_.join();
  }
}

std::shared_ptr<const core::MapState> Stage::session_map(core::MapParts parts) {
  if (session_->map_file.empty() || session_->frozen) return nullptr;
  const auto map = core::read_map(session_->map_file, *classes_, parts);
  if (!map) fail(map.message());
  return map ? *map : nullptr;
}

void Stage::save_at_end(std::function<void()> save) {
  constexpr std::chrono::milliseconds kPeriod(100);  // far below the 15 s that roslaunch waits
  saver_ = std::thread([this, kPeriod, save = std::move(save), stopped = stopped_.get_future()] {
    while (stopped.wait_for(kPeriod) != std::future_status::ready && !ros::isShuttingDown()) continue;
    if (is_unsaved_) save();
  });
}

void Stage::follow_sessions() {
  ack_publisher_ = advertise<SessionAck>("session_acks");
  listen("session_control", Keep::kPinned, queue_size_, &Stage::handle_session);
  open_queue();
}

void Stage::push(const std::string& topic, Keep keep, Worker::Task task) {
  statistics_.count_input(topic);
  worker_->push(
      [this, arrival = StageStatistics::Clock::now(), task = std::move(task)] {
        task_arrival_ = arrival;
        task();
      },
      keep, topic);
}

void Stage::count_missed(const std::string& topic, const Sequence& next, Sequence* last) {
  // Frame ids may be any number, if the message is bad.
  const std::uint64_t step = static_cast<std::uint64_t>(next.frame_id) - static_cast<std::uint64_t>(last->frame_id);
  if (next.session_id == last->session_id && next.frame_id > last->frame_id && step > 1) {
    statistics_.count_lost(kMissed + topic, step - 1);
  }
  *last = next;
}

void Stage::serve_trigger(const std::string& service, const std::function<core::Result<std::string>()>& act) {
  using Trigger = std_srvs::Trigger;
  serve<Trigger::Request, Trigger::Response>(service, [act](Trigger::Request&, Trigger::Response& response) {
    answer(act(), &response);
    return true;
  });
}

void Stage::serve_settings(const std::vector<core::OptionRow>& defaults, LiveSettings::Rows rows,
                           LiveSettings::Change change) {
  using Reconfigure = dynamic_reconfigure::Reconfigure;
  statistics_.count(kSettingsRefused, 0);
  settings_ = std::make_unique<LiveSettings>(getPrivateNodeHandle(), defaults, std::move(rows), std::move(change));
  serve<Reconfigure::Request, Reconfigure::Response>(
      "set_parameters", [this](Reconfigure::Request& request, Reconfigure::Response& response) {
        note_refusal(settings_->change(request.config));
        response.config = settings_->settings();
        return true;
      });
}

core::Status Stage::change_settings(const core::OptionTexts& texts) {
  core::Status changed = settings_->change(texts);
  note_refusal(changed);
  return changed;
}

void Stage::note_refusal(const core::Status& changed) {
  if (changed) return;
  statistics_.count(kSettingsRefused);
  NODELET_WARN("settings stay as they are: %s", changed.message().c_str());
}

void Stage::keep_timer(double period_s, const std::function<void()>& task, CallbackThread* thread) {
  const boost::function<void(const ros::WallTimerEvent&)> callback = [task](const ros::WallTimerEvent&) { task(); };
  ros::NodeHandle node(getNodeHandle());
  node.setCallbackQueue(thread != nullptr ? &thread->queue : &timer_thread_.queue);
  timers_.push_back(node.createWallTimer(ros::WallDuration(period_s), callback));
}

std::function<void()> Stage::once_in_queue(const Worker::Task& task) {
  return [this, waits = std::make_shared<std::atomic<bool>>(false), task] {
    if (waits->exchange(true)) return;
    worker_->push(
        [waits, task] {
          *waits = false;
          task();
        },
        Keep::kPinned);
  };
}

void Stage::start_timer(double period_s, const Worker::Task& task) { keep_timer(period_s, once_in_queue(task)); }

core::Result<std::string> Stage::path_below(const std::string& directory, const std::string& path, bool anywhere) {
  namespace fs = std::filesystem;
  std::error_code no_root, no_place;
  const fs::path root = fs::weakly_canonical(fs::absolute(directory.empty() ? "." : directory, no_root), no_root);
  const fs::path place = fs::weakly_canonical(root / path, no_place);
  const fs::path relative = place.lexically_relative(root);
  if (no_root || no_place) return core::Error{path + ": " + (no_root ? no_root : no_place).message()};
  const bool is_below = !relative.empty() && relative != "." && *relative.begin() != "..";
  // A link that leads to no file yet is not followed by that.
  const bool is_link = fs::is_symlink(fs::symlink_status(place, no_place));
  if ((is_below && !is_link) || anywhere) return place.string();
  return core::Error{path + ": is not below '" + root.string() + "', see save_dir and allow_any_path"};
}

void Stage::publish_done(const ros::Publisher& publisher, const ros::Time& stamp, std::int64_t frame_id,
                         std::uint8_t status, std::uint64_t map_version) const {
  auto message = boost::make_shared<FrameDone>();
  message->header.stamp = stamp;
  message->session_id = session_id_;
  message->frame_id = frame_id;
  message->map_version = map_version;
  message->status = status;
  message->stage = name_;
  publisher.publish(message);
}

void Stage::start_diagnostics() {
  for (const char* counter : {kOtherSession, kQueueFull, kErrors}) statistics_.count(counter, 0);
  updater_ = std::make_unique<diagnostic_updater::Updater>(getNodeHandle(), getPrivateNodeHandle(), getName());
  updater_->setHardwareID("none");
  updater_->add(name_, [this](diagnostic_updater::DiagnosticStatusWrapper& status) { report(status); });
  working_publisher_ = advertise<std_msgs::String>("working");
  keep_timer(kDiagnosticsPeriodS, [this] {
    updater_->force_update();
    if (!worker_ || !worker_->is_busy()) return;
    std_msgs::String working;
    working.data = name_;
    working_publisher_.publish(working);
  });
}

void Stage::start_worker(int queue_size, std::size_t inputs) {
  queue_size_ = static_cast<std::uint32_t>(queue_size);
  worker_ = std::make_unique<Worker>(queue_size_ * inputs, [this](const std::string& what) {
    statistics_.count_lost(kErrors);
    NODELET_ERROR_THROTTLE(kErrorLogPeriodS, "%s: %s", name_.c_str(), what.c_str());
  });
}

void Stage::report(diagnostic_updater::DiagnosticStatusWrapper& status) {
  std::uint64_t dropped = 0;
  for (const auto& [topic, n] : worker_ ? worker_->dropped() : std::map<std::string, std::uint64_t>()) {
    statistics_.set(std::string(kQueueFull) + ": " + topic, n);
    dropped += n;
  }
  statistics_.set_lost(kQueueFull, dropped);
  const StageStatistics::Snapshot snapshot = statistics_.take_snapshot();
  status.summary(diagnostic_msgs::DiagnosticStatus::OK, "working");
  if (!snapshot.failure.empty()) status.summary(diagnostic_msgs::DiagnosticStatus::ERROR, snapshot.failure);
  for (const auto& [topic, rate] : snapshot.input_rates_hz) status.addf(topic + " rate", "%.1f Hz", rate);
  status.add("frames processed", snapshot.processed);
  status.addf("frame rate", "%.1f Hz", snapshot.processed_hz);
  status.addf("latency p50", "%.2f ms", snapshot.latency_p50_ms);
  status.addf("latency p95", "%.2f ms", snapshot.latency_p95_ms);
  for (const auto& [name, n] : snapshot.counters) status.add(name, n);
  for (const auto& [name, text] : snapshot.texts) status.add(name, text);
  if (worker_) status.add("queue length", worker_->size());
  status.addf("memory of the process", "%.0f MiB", core::memory_of_process().resident_mb);
  for (const std::string& warning : snapshot.warnings) {
    status.mergeSummary(diagnostic_msgs::DiagnosticStatus::WARN, warning);
  }
}

bool Stage::is_current(std::uint32_t session_id) {
  if (session_id == session_id_ && session_id != 0) return true;
  statistics_.count(kOtherSession);
  return false;
}

void Stage::handle_session(const SessionControl::ConstPtr& control) {
  // A late nodelet may see the latched PAUSE of a session whose START it missed; a latched START may come twice; a
  // reloaded owner may use an id again.
  const bool is_start = control->command == SessionControl::COMMAND_START;
  if (control->session_id != session_id_ || (is_start && control->header.stamp != session_stamp_)) {
    session_id_ = control->session_id;
    session_ = control;
    statistics_.set_failure(name_, "");  // which a session had before: what has not started follows none
    reset_session();
    set_localization(control->localization != 0);
  }
  if (control->localization != session_->localization) set_localization(control->localization != 0);
  session_ = control;
  if (is_start) session_stamp_ = control->header.stamp;
  auto ack = boost::make_shared<SessionAck>();
  ack->header.stamp = control->header.stamp;
  ack->session_id = control->session_id;
  ack->command = control->command;
  ack->stage = name_;
  ack_publisher_.publish(ack);
}

}  // namespace semantic_topo_loop
