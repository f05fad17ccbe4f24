#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace semantic_topo_loop::core {

using Vec2 = Eigen::Vector2d;
using Vec3 = Eigen::Vector3d;
using Vec4 = Eigen::Vector4d;
using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat3 = Eigen::Matrix3d;
using Mat4 = Eigen::Matrix4d;
using Mat6 = Eigen::Matrix<double, 6, 6>;
using Mat34 = Eigen::Matrix<double, 3, 4>;
using Quaternion = Eigen::Quaterniond;

constexpr double kPi = 3.14159265358979323846;
constexpr double degrees(double radians) { return radians * 180.0 / kPi; }
constexpr double radians(double degrees) { return degrees * kPi / 180.0; }

}  // namespace semantic_topo_loop::core
