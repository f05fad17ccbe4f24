#!/usr/bin/env python3
"""The session's services during playback, and a parameter that nobody knows."""
import os
import shutil
import tempfile
import threading
import time
import unittest

import rospy
import rostest
from std_srvs.srv import Trigger

from playback import PACKAGE, demo, wait_until
from semantic_topo_loop.msg import FrameDone


class ControlTest(unittest.TestCase):
    def setUp(self):
        rospy.init_node('control_test')
        self.directory = tempfile.mkdtemp(prefix='semantic_topo_loop_control_')
        self.lock = threading.Lock()
        self.done = []
        self.subscriber = rospy.Subscriber('/%s/frame_done' % PACKAGE, FrameDone, self.take_done, queue_size=10000)

    def tearDown(self):
        self.subscriber.unregister()
        shutil.rmtree(self.directory)

    def take_done(self, message):
        with self.lock:
            self.done.append(message)

    def call(self, service):
        self.assertTrue(rospy.ServiceProxy('/%s/pose_frontend/%s' % (PACKAGE, service), Trigger)().success)

    def test_pause_resume_reset(self):
        results = os.path.join(self.directory, 'results')
        launch = demo(duration='10', data=self.directory, lockstep='false', output=results)
        try:
            self.assertTrue(wait_until(lambda: len(self.done) > 30, 60), launch.output())
            self.call('pause')
            time.sleep(0.5)
            paused_at = len(self.done)
            time.sleep(1.0)
            self.assertEqual(len(self.done), paused_at, 'the player waits while the session is paused')
            self.call('resume')
            self.assertTrue(wait_until(lambda: len(self.done) > paused_at + 30, 10))
            self.assertEqual({message.session_id for message in self.done}, {1})
            self.call('reset')
            self.assertTrue(launch.wait(40), launch.output())
        finally:
            launch.stop()
        self.assertTrue(launch.player_finished(), launch.output())
        second = [message.frame_id for message in self.done if message.session_id == 2]
        self.assertEqual(second, list(range(len(second))), 'a session counts its own frames')
        with open(os.path.join(results, 'trajectory.txt')) as file:
            self.assertEqual(sum(1 for _ in file), len(second) - 1, 'the files are those of the last session')

    def test_an_unknown_parameter_is_named(self):
        config = os.path.join(self.directory, 'config.yaml')
        with open(config, 'w') as file:
            file.write('loop: {no_such_key: 1}\n')
        launch = demo(duration='4', data=self.directory, config=config)
        error = "unknown parameter 'loop.no_such_key' = '1'"
        try:
            self.assertTrue(wait_until(lambda: error in launch.output(), 30), launch.output())
            self.assertIsNone(launch.process.poll(), 'the manager lives')
        finally:
            launch.stop()
        self.assertTrue(all('FATAL' in line for line in launch.lines if error in line))
        # Nothing of it is left for the next launch on the same master.
        launch = demo(duration='4', data=self.directory)
        ended = launch.wait(60)
        launch.stop()
        self.assertTrue(ended and launch.player_finished(), launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'control', ControlTest)
