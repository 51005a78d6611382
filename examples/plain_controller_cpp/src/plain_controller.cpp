// Copyright 2026 POSOR maintainers
// SPDX-License-Identifier: Apache-2.0
// Moves a stage so that the endpoint stays at its target; stops where the pose is not OK.
//
// ros2 run plain_controller_cpp plain_controller --ros-args -r __ns:=/five_axis

#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "geometry_msgs/msg/pose_stamped.hpp"
#include "geometry_msgs/msg/vector3_stamped.hpp"
#include "posor_msgs/msg/endpoint_state.hpp"
#include "rclcpp/rclcpp.hpp"

using geometry_msgs::msg::PoseStamped;
using geometry_msgs::msg::Vector3Stamped;
using posor_msgs::msg::EndpointState;
using Stamp = std::pair<int32_t, uint32_t>;

constexpr double MAX_AGE_S = 0.1;
constexpr std::size_t KEPT = 100;
constexpr char SILENT[] = "no message on endpoint/state";

template<typename Message>
Stamp stamp_of(const Message & message)
{
  return {message.header.stamp.sec, message.header.stamp.nanosec};
}

template<typename Message>
void keep(std::map<Stamp, Message> & messages, const Message & message)
{
  if (!messages.empty() && stamp_of(message) < messages.rbegin()->first) {
    messages.clear();  // time has gone back
  }
  messages[stamp_of(message)] = message;
  if (messages.size() > KEPT) {
    messages.erase(messages.begin());
  }
}

class PlainController : public rclcpp::Node
{
public:
  PlainController()
  : Node("plain_controller")
  {
    output_ = create_publisher<Vector3Stamped>("stage/command", 10);
    target_subscription_ = create_subscription<PoseStamped>(
      "target/endpoint", 10, [this](const PoseStamped & target) {keep(targets_, target);});
    stage_subscription_ = create_subscription<Vector3Stamped>(
      "stage/position", 10, [this](const Vector3Stamped & stage) {keep(positions_, stage);});
    state_subscription_ = create_subscription<EndpointState>(
      "endpoint/state", 10, [this](const EndpointState & measured) {on_state(measured);});
    watchdog_ = create_wall_timer(
      std::chrono::duration<double>(MAX_AGE_S), [this] {stop();});
  }

private:
  void on_state(const EndpointState & measured)
  {
    const auto target = targets_.find(stamp_of(measured));
    const auto stage = positions_.find(stamp_of(measured));
    const double age_s =
      now().seconds() - (measured.header.stamp.sec + 1e-9 * measured.header.stamp.nanosec);
    if (measured.state != EndpointState::STATE_OK || std::abs(age_s) > MAX_AGE_S) {
      reason_ = measured.reason.empty() ? "the pose is not OK or too old" : measured.reason;
      return;
    }
    reason_ = "nothing to command";
    if (target != targets_.end() && stage != positions_.end()) {
      command(measured.pose, target->second.pose.position, stage->second);
    }
  }

  // Commands R^T (target - measured) + stage: the position of the stage that would have removed the error.
  void command(
    const geometry_msgs::msg::Pose & measured, const geometry_msgs::msg::Point & target,
    const Vector3Stamped & stage)
  {
    const auto & p = measured.position;
    const auto & q = measured.orientation;
    const double x = target.x - p.x, y = target.y - p.y, z = target.z - p.z;
    const double a = y * q.z - z * q.y, b = z * q.x - x * q.z, c = x * q.y - y * q.x;
    auto message = stage;
    message.vector.x += x + 2.0 * (q.w * a + b * q.z - c * q.y);
    message.vector.y += y + 2.0 * (q.w * b + c * q.x - a * q.z);
    message.vector.z += z + 2.0 * (q.w * c + a * q.y - b * q.x);
    if (std::isfinite(message.vector.x + message.vector.y + message.vector.z)) {
      output_->publish(message);
      watchdog_->reset();
    }
  }

  // One scan without a pose is no reason to stop; MAX_AGE_S without one is. Another machine would brake here.
  void stop()
  {
    RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 1000, "stopped: %s", reason_.c_str());
    reason_ = SILENT;
  }

  std::string reason_ = SILENT;
  std::map<Stamp, PoseStamped> targets_;
  std::map<Stamp, Vector3Stamped> positions_;
  rclcpp::Publisher<Vector3Stamped>::SharedPtr output_;
  rclcpp::Subscription<PoseStamped>::SharedPtr target_subscription_;
  rclcpp::Subscription<Vector3Stamped>::SharedPtr stage_subscription_;
  rclcpp::Subscription<EndpointState>::SharedPtr state_subscription_;
  rclcpp::TimerBase::SharedPtr watchdog_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<PlainController>());
  rclcpp::shutdown();
  return 0;
}
