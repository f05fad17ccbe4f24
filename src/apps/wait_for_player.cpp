#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <std_msgs/String.h>

#include <cstdio>
#include <optional>

/// Ends when the player does, with 0 if the recording went through the chain to its end, else with 1 and what the
/// player said. The player lives in a manager that others use; this process is what a launch file can require.
int main(int argc, char** argv) {
  ros::init(argc, argv, "wait_for_player");
  ros::NodeHandle node;
  std::optional<bool> finished;
  const boost::function<void(const std_msgs::String::ConstPtr&)> callback = [&finished](const auto& status) {
    const bool is_failure = status->data.rfind("stalled", 0) == 0 || status->data.rfind("failed", 0) == 0;
    if (status->data == "finished") finished = true;
    if (is_failure) finished = false;
    if (finished) std::printf("player: %s\n", status->data.c_str());
  };
  const ros::Subscriber subscriber = node.subscribe<std_msgs::String>("player_status", 10, callback);
  while (ros::ok() && !finished) ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.2));
  return finished.value_or(false) ? 0 : 1;
}
