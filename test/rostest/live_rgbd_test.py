#!/usr/bin/env python3
"""slam.launch with a live RGB-D camera: frames, what bad images are answered with, and topics that fall silent."""
import time
import unittest

import rospy
import rostest
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

import wall
from live_feed import START_S, Topic
from playback import PACKAGE, Diagnostics, Launch, wait_until
from semantic_topo_loop.msg import Frame, FrameDone, SessionControl

DEPTH_DELAY_S = 0.006


class LiveRgbdTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('live_rgbd_test')
        cls.launch = Launch('slam.launch', pose_source='rgbd', color='/color', depth='/depth', camera_info='/info',
                            use_detections='false')
        cls.color = rospy.Publisher('/color', Image, queue_size=100)
        cls.depth = rospy.Publisher('/depth', Image, queue_size=100)
        cls.info = rospy.Publisher('/info', CameraInfo, queue_size=100)
        cls.frames, cls.done = Topic('frames', Frame), Topic('frame_done', FrameDone)
        cls.control = Topic('session_control', SessionControl)
        cls.parents = {}
        cls.diagnostics = Diagnostics()
        rospy.Subscriber('/tf', TFMessage, cls.take_tf)
        publishers = (cls.color, cls.depth, cls.info)
        up = wait_until(lambda: cls.control.messages and all(p.get_num_connections() > 0 for p in publishers), 40)
        assert up, cls.launch.output()
        cls.index = 0

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()

    @classmethod
    def take_tf(cls, message):
        for transform in message.transforms:
            cls.parents[transform.child_frame_id] = transform.header.frame_id

    def see(self, time_s, focal=wall.FOCAL, depth=None, with_depth=True):
        stamp = rospy.Time.from_sec(START_S + time_s)
        self.info.publish(wall.camera_info(stamp, focal))
        self.color.publish(wall.color(stamp, self.index))
        type(self).index += 1
        if with_depth:
            late = rospy.Time.from_sec(START_S + time_s + DEPTH_DELAY_S)
            self.depth.publish(depth(late) if depth else wall.depth(late))
        time.sleep(wall.PERIOD_S)

    def assert_status(self, time_s, status):
        answer = self.done.at(time_s)
        self.assertIsNotNone(answer, 'no answer for %s: %s' % (time_s, self.diagnostics.values))
        self.assertEqual(answer.status, status, time_s)

    def assert_counted(self, key, least=1):
        self.assertTrue(wait_until(lambda: self.diagnostics.count('RgbdFrontend', key) >= least, 10),
                        '%s: %s' % (key, self.diagnostics.values))

    def test_1_no_calibration(self):
        # All zero, as drivers without a calibration send it; the pair is known once the next image has come.
        for i in range(3):
            self.see(0.1 * i, focal=0.0)
        self.assert_status(0.0, FrameDone.STATUS_FAILED)
        self.assert_counted('images without a calibration')
        self.assert_counted('camera_info without a usable calibration')

    def test_2_frames_and_tf(self):
        for i in range(12):
            self.see(1.0 + wall.PERIOD_S * i)
        self.assert_status(1.0, FrameDone.STATUS_PROCESSED)
        first, last = self.frames.at(1.0), self.frames.at(1.0 + wall.PERIOD_S * 10)
        self.assertIsNotNone(last)
        moved = last.odom_from_camera.position.x - first.odom_from_camera.position.x
        self.assertAlmostEqual(moved, 10 * wall.STEP_M, delta=0.02)
        self.assertTrue(wait_until(lambda: self.parents.get(wall.FRAME[1:]) == 'odom', 10), self.parents)
        self.assertEqual(self.parents.get('odom'), 'map')

    def test_3_bad_images(self):
        self.see(2.0, with_depth=False)
        self.see(2.0 + wall.PERIOD_S)
        self.see(2.0 + 2 * wall.PERIOD_S, depth=lambda stamp: wall.depth(stamp, width=100, height=100))
        self.see(2.0 + 3 * wall.PERIOD_S)
        self.see(2.0 + 4 * wall.PERIOD_S)
        self.assert_status(2.0, FrameDone.STATUS_FAILED)
        self.assert_status(2.0 + 2 * wall.PERIOD_S, FrameDone.STATUS_FAILED)
        self.assert_status(2.0 + 3 * wall.PERIOD_S, FrameDone.STATUS_PROCESSED)
        self.assert_counted('colour images without depth')
        self.assert_counted('unusable images')

    def test_4_a_jump_back_is_a_new_session(self):
        before = self.control.messages[-1].session_id
        for i in range(4):
            self.see(0.5 + wall.PERIOD_S * i)
        self.assert_status(0.5, FrameDone.STATUS_PROCESSED)
        self.assertEqual(self.control.messages[-1].session_id, before + 1)
        self.assertEqual(self.frames.at(0.5).frame_id, 0)

    def test_5_silence_is_reported(self):
        begin = time.monotonic()
        i = 0
        while '/depth' not in self.diagnostics.summaries.get('RgbdFrontend', '') and time.monotonic() - begin < 6.0:
            self.see(3.0 + wall.PERIOD_S * i, with_depth=False)
            i += 1
        summary = self.diagnostics.summaries.get('RgbdFrontend', '')
        self.assertLess(time.monotonic() - begin, 5.5)
        self.assertIn("no images on '/depth'", summary)
        self.assertIn('gap between the last stamps', summary)
        self.assertIn("'/color': last image", summary)
        for i in range(4):
            self.see(13.0 + wall.PERIOD_S * i)
        self.assertTrue(wait_until(lambda: self.diagnostics.summaries.get('RgbdFrontend') == 'working', 4), self.diagnostics.summaries)

    def test_6_depth_out_of_reach_is_reported(self):
        # In millimetres, as floats, which are metres.
        for i in range(45):
            self.see(14.0 + wall.PERIOD_S * i, depth=lambda stamp: wall.depth(stamp, value=1000.0 * wall.DISTANCE_M))
        summaries = self.diagnostics.summaries
        self.assertTrue(wait_until(lambda: 'depth.max_m = 8 m' in summaries.get('RgbdFrontend', ''), 5), summaries)
        self.assertIn('32FC1', summaries['RgbdFrontend'])


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'live_rgbd', LiveRgbdTest)
