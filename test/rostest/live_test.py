#!/usr/bin/env python3
"""slam.launch on live topics: tf, camera_info and detections that come from other processes, good ones and bad ones."""
import math

import rostest
from tf2_msgs.msg import TFMessage

from live_feed import LiveFeed
from playback import PACKAGE, wait_until
from semantic_topo_loop.msg import FrameDone, SessionControl


class LiveTest(LiveFeed):
    def test_1_poses_are_interpolated_and_detections_joined(self):
        self.move(0.0, 1.0)
        for i in range(1, 10):
            self.see(0.1 * i + 0.007)
        self.assert_status(0.907, FrameDone.STATUS_PROCESSED)
        self.assertIsNotNone(self.frames.at(0.907))
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
        self.see(1.307, with_detections=False, focal_length=0.0)
        self.assert_status(1.307, FrameDone.STATUS_FAILED)
        self.assert_counted('PoseFrontend', 'camera_info without a usable calibration')
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
        self.see(1.357)
        self.assert_status(1.357, FrameDone.STATUS_FAILED)
        self.assertTrue(wait_until(lambda: self.control.messages[-1].command == SessionControl.COMMAND_PAUSE, 10))
        self.call('resume')
        self.see(1.407)
        self.assert_status(1.407, FrameDone.STATUS_PROCESSED)
        self.assertEqual(self.done.at(1.407).session_id, before)
        self.call('reset')
        self.see(1.507)
        self.assertIsNotNone(self.frames.at(1.507))
        self.assertEqual(self.frames.at(1.507).session_id, before + 1)
        self.assertEqual(self.frames.at(1.507).frame_id, 0)


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'live', LiveTest)
