#!/usr/bin/env python3
"""slam.launch with nav_msgs/Odometry, frames made by the detector's stamps, and a cloud with each image."""
import struct

import rospy
import rostest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2, PointField
from tf2_msgs.msg import TFMessage

from live_feed import START_S, LiveFeed
from playback import PACKAGE
from semantic_topo_loop.msg import FrameDone


class LiveOdometryTest(LiveFeed):
    arguments = {'pose_source': 'odometry', 'trigger': 'detections', 'use_points': 'true'}

    def drive(self, begin_s, end_s):
        """1 m/s along x at 50 Hz, with a tenth of a m/s and rad/s of noise."""
        for i in range(round(50 * begin_s), round(50 * end_s) + 1):
            message = Odometry()
            message.header.frame_id = '/odom'
            message.header.stamp = rospy.Time.from_sec(START_S + i / 50.0)
            message.child_frame_id = '/base_link'
            message.pose.pose.position.x = i / 50.0
            message.pose.pose.orientation.w = 1.0
            for k in range(6):
                message.twist.covariance[7 * k] = 0.01
            self.odometry.publish(message)

    def show_points(self, time_s, frame_id='/lens'):
        points = [(0.0, 0.0, 1.0), (0.1, 0.2, 2.0), (float('nan'), 0.0, 1.0)]
        message = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points), is_dense=False)
        message.header.frame_id = frame_id
        message.header.stamp = rospy.Time.from_sec(START_S + time_s)
        message.fields = [PointField(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate('xyz')]
        message.data = b''.join(struct.pack('<fff', *point) for point in points)
        self.cloud.publish(message)

    def test_poses_covariance_and_points_reach_the_frame(self):
        self.tf_static.publish(TFMessage([self.transform('base_link', 'lens', 0.0, 0.5)]))
        self.drive(0.0, 1.0)
        for time_s in (0.107, 0.207, 0.307):
            self.show_points(time_s)
            self.see(time_s)
            self.assert_status(time_s, FrameDone.STATUS_PROCESSED)
        frame = self.frames.at(0.307)
        self.assertAlmostEqual(frame.odom_from_camera.position.x, 0.807, places=6)
        self.assertTrue(frame.has_covariance)
        self.assertAlmostEqual(frame.covariance[0], 0.01 * 0.1 ** 2, places=7)
        self.assertTrue(frame.has_points)
        self.assertEqual((frame.points.width, frame.points.header.frame_id), (2, 'lens'))

    def test_unusable_points_are_counted(self):
        self.drive(1.0, 2.0)
        self.show_points(1.107, '/somewhere_else')
        self.see(1.107)
        self.assert_status(1.107, FrameDone.STATUS_PROCESSED)
        self.assertFalse(self.frames.at(1.107).has_points)
        self.assert_counted('PoseFrontend', 'unusable points')
        self.see(1.207)
        self.assert_status(1.207, FrameDone.STATUS_PROCESSED)
        self.assert_counted('PoseFrontend', 'images without points')


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'live_odometry', LiveOdometryTest)
