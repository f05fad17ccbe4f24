#include "ros/stage.h"

#include <atomic>

#include "semantic_topo_loop/io/yaml_files.h"

namespace semantic_topo_loop {
namespace {

constexpr char kOtherSession[] = "dropped, other session";
constexpr char kQueueFull[] = "dropped, queue full";
constexpr char kErrors[] = "errors";
constexpr double kDiagnosticsPeriodS = 1.0;  ///< diagnostic_updater's own
constexpr double kErrorLogPeriodS = 5.0;     ///< an error a frame must not flood the log

}  // namespace

void Stage::fail(const std::string& error) {
  NODELET_FATAL("%s is not working: %s", name_.c_str(), error.c_str());
  statistics_.set_failure(error);
}

std::shared_ptr<const core::ClassTable> Stage::load_classes(const std::string& path) {
  core::Result<core::ClassTable> classes = core::read_class_table(path);
  if (classes) return std::make_shared<const core::ClassTable>(std::move(*classes));
  fail(classes.message());
  return nullptr;
}

void Stage::complain(const std::string& cause, const std::string& detail) {
  if (!statistics_.count_first(cause)) return;
  NODELET_WARN("%s: %s (further ones are counted in the diagnostics)", cause.c_str(), detail.c_str());
}

void Stage::stop() {
  for (ros::Subscriber& subscriber : subscribers_) subscriber.shutdown();
  for (ros::ServiceServer& service : services_) service.shutdown();
  for (ros::WallTimer& timer : timers_) timer.stop();
  diagnostics_timer_.stop();
  if (worker_) worker_->close();
}

void Stage::follow_sessions() {
  ack_publisher_ = advertise<SessionAck>("session_acks");
  const boost::function<void(const SessionControl::ConstPtr&)> callback = [this](const SessionControl::ConstPtr& m) {
    push("session_control", Keep::kAlways, [this, m] { handle_session(*m); });
  };
  keep_subscriber(getNodeHandle().subscribe<SessionControl>("session_control", queue_size_, callback));
}

void Stage::push(const std::string& topic, Keep keep, Worker::Task task) {
  statistics_.count_input(topic);
  worker_->push(
      [this, arrival = StageStatistics::Clock::now(), task = std::move(task)] {
        task_arrival_ = arrival;
        task();
      },
      keep);
}

void Stage::start_timer(double period_s, Worker::Task task) {
  const auto waits = std::make_shared<std::atomic<bool>>(false);
  const boost::function<void(const ros::WallTimerEvent&)> callback = [this, waits, task](const ros::WallTimerEvent&) {
    if (waits->exchange(true)) return;
    worker_->push(
        [waits, task] {
          *waits = false;
          task();
        },
        Keep::kAlways);
  };
  timers_.push_back(getNodeHandle().createWallTimer(ros::WallDuration(period_s), callback));
}

void Stage::start_diagnostics() {
  for (const char* counter : {kOtherSession, kQueueFull, kErrors}) statistics_.count(counter, 0);
  updater_ = std::make_unique<diagnostic_updater::Updater>(getNodeHandle(), getPrivateNodeHandle(), getName());
  updater_->setHardwareID("none");
  updater_->add(name_, [this](diagnostic_updater::DiagnosticStatusWrapper& status) { report(status); });
  const boost::function<void(const ros::WallTimerEvent&)> callback = [this](const ros::WallTimerEvent&) {
    updater_->force_update();
  };
  diagnostics_timer_ = getNodeHandle().createWallTimer(ros::WallDuration(kDiagnosticsPeriodS), callback);
}

void Stage::start_worker(int queue_size, std::size_t inputs) {
  queue_size_ = static_cast<std::uint32_t>(queue_size);
  worker_ = std::make_unique<Worker>(queue_size_ * inputs, [this](const std::string& what) {
    statistics_.count(kErrors);
    NODELET_ERROR_THROTTLE(kErrorLogPeriodS, "%s: %s", name_.c_str(), what.c_str());
  });
}

void Stage::report(diagnostic_updater::DiagnosticStatusWrapper& status) {
  if (worker_) statistics_.set(kQueueFull, worker_->dropped());
  const StageStatistics::Snapshot snapshot = statistics_.take_snapshot();
  if (!snapshot.failure.empty()) {
    status.summary(diagnostic_msgs::DiagnosticStatus::ERROR, snapshot.failure);
    return;
  }
  const auto counter = [&snapshot](const char* key) { return snapshot.counters.at(key); };
  const bool lossy = counter(kQueueFull) > 0 || counter(kErrors) > 0;
  status.summary(lossy ? diagnostic_msgs::DiagnosticStatus::WARN : diagnostic_msgs::DiagnosticStatus::OK,
                 lossy ? "frames were lost" : "working");
  for (const auto& [topic, rate] : snapshot.input_rates_hz) status.addf(topic + " rate", "%.1f Hz", rate);
  status.add("frames processed", snapshot.processed);
  status.addf("frame rate", "%.1f Hz", snapshot.processed_hz);
  status.addf("latency p50", "%.2f ms", snapshot.latency_p50_ms);
  status.addf("latency p95", "%.2f ms", snapshot.latency_p95_ms);
  for (const auto& [name, n] : snapshot.counters) status.add(name, n);
  if (worker_) status.add("queue length", worker_->size());
  add_diagnostics(status);
}

bool Stage::is_current(std::uint32_t session_id) {
  if (session_id == session_id_ && session_id != 0) return true;
  statistics_.count(kOtherSession);
  return false;
}

void Stage::handle_session(const SessionControl& control) {
  // A late nodelet may see the latched PAUSE of a session whose START it missed; a latched START may come twice; a
  // reloaded owner may use an id again.
  const bool is_start = control.command == SessionControl::COMMAND_START;
  if (control.session_id != session_id_ || (is_start && control.header.stamp != session_stamp_)) {
    session_id_ = control.session_id;
    reset_session();
  }
  if (is_start) session_stamp_ = control.header.stamp;
  auto ack = boost::make_shared<SessionAck>();
  ack->header.stamp = control.header.stamp;
  ack->session_id = control.session_id;
  ack->command = control.command;
  ack->stage = name_;
  ack_publisher_.publish(ack);
}

}  // namespace semantic_topo_loop
