#!/usr/bin/env python3
"""slam.launch on live topics: tf, camera_info and detections that come from other processes, good ones and bad ones."""
import math
import threading
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from playback import PACKAGE, Launch, wait_until
from semantic_topo_loop.msg import Detection, DetectionArray, Frame, FrameDone, SessionControl

START_S = 1000.0
CUP = 41


class Topic:
    """Every message of a topic, in order."""

    def __init__(self, name, kind):
        self.messages = []
        self.lock = threading.Lock()
        self.subscriber = rospy.Subscriber('/%s/%s' % (PACKAGE, name), kind, self.take, queue_size=1000)

    def take(self, message):
        with self.lock:
            self.messages.append(message)

    def at(self, time_s):
        """The last message with this stamp, or None."""
        stamp = rospy.Time.from_sec(START_S + time_s)
        with self.lock:
            found = [m for m in self.messages if m.header.stamp == stamp]
        return found[-1] if found else None


class LiveTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('live_test')
        cls.launch = Launch('slam.launch', camera_info='/camera_info', detections='/detector',
                            detection_timeout_s='0.4', pose_timeout_s='0.4')
        cls.tf = rospy.Publisher('/tf', TFMessage, queue_size=1000)
        cls.tf_static = rospy.Publisher('/tf_static', TFMessage, queue_size=10, latch=True)
        cls.camera_info = rospy.Publisher('/camera_info', CameraInfo, queue_size=100)
        cls.detections = rospy.Publisher('/detector', DetectionArray, queue_size=100)
        cls.frames = Topic('frames', Frame)
        cls.joined = Topic('detections', DetectionArray)
        cls.done = Topic('frame_done', FrameDone)
        cls.control = Topic('session_control', SessionControl)
        cls.counters = {}
        rospy.Subscriber('/diagnostics', DiagnosticArray, cls.take_diagnostics)
        extrinsics = cls.transform('/base_link', '/lens', 0.0, 0.0)
        cls.tf_static.publish(TFMessage([extrinsics]))
        publishers = [cls.tf, cls.tf_static, cls.camera_info, cls.detections]
        up = wait_until(lambda: cls.control.messages and all(p.get_num_connections() > 0 for p in publishers), 40)
        assert up, cls.launch.output()

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()

    @classmethod
    def take_diagnostics(cls, message):
        for status in message.status:
            for value in status.values:
                cls.counters[status.name.split(': ')[-1], value.key] = value.value

    @staticmethod
    def transform(parent, child, time_s, x):
        message = TransformStamped()
        message.header.frame_id = parent
        message.header.stamp = rospy.Time.from_sec(START_S + time_s)
        message.child_frame_id = child
        message.transform.translation.x = x
        message.transform.rotation.w = 1.0
        return message

    def move(self, begin_s, end_s):
        """1 m/s along x, sampled at 50 Hz."""
        for i in range(round(50 * begin_s), round(50 * end_s) + 1):
            self.tf.publish(TFMessage([self.transform('/odom', '/base_link', i / 50.0, i / 50.0)]))

    def see(self, time_s, with_detections=True, boxes=((100, 100, 200, 200),)):
        info = CameraInfo(width=640, height=480, distortion_model='plumb_bob', D=[0.0] * 5)
        info.header.frame_id = '/lens'
        info.header.stamp = rospy.Time.from_sec(START_S + time_s)
        info.K = [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0]
        self.camera_info.publish(info)
        if not with_detections:
            return
        message = DetectionArray()
        message.header.stamp = info.header.stamp
        for x1, y1, x2, y2 in boxes:
            detection = Detection(class_id=CUP, score=0.9)
            detection.box.x1, detection.box.y1, detection.box.x2, detection.box.y2 = x1, y1, x2, y2
            message.detections.append(detection)
        self.detections.publish(message)

    def assert_status(self, time_s, status):
        self.assertTrue(wait_until(lambda: self.done.at(time_s) is not None, 10), 'no answer for %s' % time_s)
        self.assertEqual(self.done.at(time_s).status, status, time_s)

    def assert_counted(self, stage, key, least=1):
        self.assertTrue(wait_until(lambda: float(self.counters.get((stage, key), 0)) >= least, 10),
                        '%s: %s is %s' % (stage, key, self.counters.get((stage, key))))

    def call(self, service):
        name = '/%s/pose_frontend/%s' % (PACKAGE, service)
        self.assertTrue(rospy.ServiceProxy(name, Trigger)().success)

    def test_1_poses_are_interpolated_and_detections_joined(self):
        self.move(0.0, 1.0)
        for i in range(1, 10):
            self.see(0.1 * i + 0.007)
        self.assert_status(0.907, FrameDone.STATUS_PROCESSED)
        frame = self.frames.at(0.507)
        self.assertAlmostEqual(frame.odom_from_camera.position.x, 0.507, places=7)
        self.assertEqual((frame.header.frame_id, frame.camera_frame), ('odom', 'lens'))
        self.assertEqual([f.frame_id for f in self.frames.messages[:9]], list(range(9)))
        self.assertEqual(len(self.joined.at(0.507).detections), 1)

    def test_2_bad_input_is_counted_and_left_out(self):
        bad = self.transform('odom', 'base_link', 1.01, math.nan)
        unnormalised = self.transform('odom', 'base_link', 1.015, 0.0)
        unnormalised.transform.rotation.z = 1.0
        self.tf.publish(TFMessage([bad, unnormalised]))
        self.move(1.02, 2.0)
        self.see(1.107, boxes=((100, 100, 200, 200), (200, 100, 100, 200), (math.nan, 0, 9, 9)))
        self.assert_status(1.107, FrameDone.STATUS_PROCESSED)
        self.assertEqual(len(self.joined.at(1.107).detections), 1)
        self.see(1.207, with_detections=False)
        self.assert_status(1.207, FrameDone.STATUS_PROCESSED)
        self.assertEqual(len(self.joined.at(1.207).detections), 0)
        self.see(1.207, with_detections=False)
        self.assert_counted('PoseFrontend', 'images with the stamp of the one before')
        self.see(1.107, with_detections=False)
        self.assert_counted('PoseFrontend', 'images out of order')
        self.assert_counted('PoseFrontend', 'bad transforms')
        self.assert_counted('DetectionIngestion', 'frames without detections')

    def test_3_no_pose_is_no_frame(self):
        self.move(2.0, 2.2)
        self.move(3.0, 3.4)
        self.see(2.607, with_detections=False)
        self.assert_status(2.607, FrameDone.STATUS_NO_POSE)
        self.see(3.107)
        self.assert_status(3.107, FrameDone.STATUS_PROCESSED)
        self.assertTrue(self.frames.at(3.107).is_break)
        self.see(9.007, with_detections=False)
        self.assert_status(9.007, FrameDone.STATUS_NO_POSE)
        self.assert_counted('PoseFrontend', 'images without a pose', 2)

    def test_4_a_jump_back_in_time_begins_a_session(self):
        before = self.control.messages[-1].session_id
        self.move(0.0, 1.0)
        self.see(0.307)
        self.assertTrue(wait_until(lambda: self.control.messages[-1].session_id == before + 1, 10))
        self.assertEqual(self.control.messages[-1].command, SessionControl.COMMAND_START)
        self.assertTrue(wait_until(lambda: self.frames.messages[-1].session_id == before + 1, 10))
        self.assertEqual(self.frames.messages[-1].frame_id, 0)

    def test_5_pause_resume_reset(self):
        before = self.control.messages[-1].session_id
        self.move(1.0, 2.0)
        self.call('pause')
        self.see(1.307)
        self.assert_status(1.307, FrameDone.STATUS_FAILED)
        self.assertEqual(self.control.messages[-1].command, SessionControl.COMMAND_PAUSE)
        self.call('resume')
        self.see(1.407)
        self.assert_status(1.407, FrameDone.STATUS_PROCESSED)
        self.assertEqual(self.done.at(1.407).session_id, before)
        self.call('reset')
        self.see(1.507)
        self.assertTrue(wait_until(lambda: self.frames.at(1.507) is not None, 10))
        self.assertEqual(self.frames.at(1.507).session_id, before + 1)
        self.assertEqual(self.frames.at(1.507).frame_id, 0)


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'live', LiveTest)
