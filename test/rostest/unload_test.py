#!/usr/bin/env python3
"""A stage that is unloaded in mid-stream: the others live on, and the player ends and names it."""
import os
import shutil
import subprocess
import tempfile
import threading
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray

from playback import PACKAGE, demo, wait_until
from semantic_topo_loop.msg import AssociationArray, FrameDone


class UnloadTest(unittest.TestCase):
    def setUp(self):
        rospy.init_node('unload_test')
        self.directory = tempfile.mkdtemp(prefix='semantic_topo_loop_unload_')
        self.lock = threading.Lock()
        self.done = 0
        self.associations = 0
        self.alive = set()
        rospy.Subscriber('/%s/frame_done' % PACKAGE, FrameDone, self.take_done)
        rospy.Subscriber('/%s/associations' % PACKAGE, AssociationArray, self.take_associations)
        rospy.Subscriber('/diagnostics', DiagnosticArray, self.take_diagnostics)

    def tearDown(self):
        shutil.rmtree(self.directory)

    def take_done(self, _):
        with self.lock:
            self.done += 1

    def take_associations(self, _):
        with self.lock:
            self.associations += 1

    def take_diagnostics(self, message):
        with self.lock:
            self.alive |= {status.name.split(': ')[-1] for status in message.status}

    def test_unloaded_stage_is_named(self):
        launch = demo(duration='30', data=self.directory, lockstep='false', stall_timeout_s='4')
        try:
            self.assertTrue(wait_until(lambda: self.done > 60, 60), launch.output())
            unloaded = subprocess.run(['rosrun', 'nodelet', 'nodelet', 'unload', '/%s/quadric_mapping' % PACKAGE,
                                       '/%s/manager' % PACKAGE], stdout=subprocess.DEVNULL, timeout=20)
            self.assertEqual(unloaded.returncode, 0)
            with self.lock:
                self.alive.clear()
                before = self.associations
            others = {'PoseFrontend', 'DetectionIngestion', 'ObjectAssociation', 'LoopDetection', 'PoseGraph',
                      'Recorder', 'Visualization', 'Player'}
            self.assertTrue(wait_until(lambda: others <= self.alive, 3.5), self.alive)
            self.assertNotIn('QuadricMapping', self.alive)
            self.assertGreater(self.associations, before)
            self.assertTrue(launch.wait(40), launch.output())
        finally:
            launch.stop()
        fatal = [line for line in launch.lines if 'FATAL' in line]
        self.assertEqual(len(fatal), 1, fatal)
        self.assertIn('QuadricMapping', fatal[0])
        self.assertIn('player: stalled: QuadricMapping', launch.output())
        self.assertIn('exit code 1', launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'unload', UnloadTest)
