#!/usr/bin/env python3
"""A run's submaps, saved by service, and a later run that finds its place among them."""
import json
import os
import shutil
import tempfile
import unittest

import rospkg
import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from std_srvs.srv import Trigger

from playback import PACKAGE, demo, run_program, wait_until


class EarlierMapTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('earlier_map_test')
        cls.directory = tempfile.mkdtemp(prefix='semantic_topo_loop_earlier_map_')

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.directory)

    def play(self, name, **arguments):
        """Plays the room to its end; the nodes stay up."""
        launch = demo(duration='20', data=os.path.join(self.directory, name),
                      output=os.path.join(self.directory, name, 'results'), exit_at_end='false', **arguments)
        try:
            status, _ = run_program('wait_for_player', '__ns:=/' + PACKAGE, timeout_s=90)
            self.assertEqual(status, 0, launch.output())
        except BaseException:
            launch.stop()
            raise
        return launch

    def test_a_later_run_finds_its_place(self):
        submaps = os.path.join(self.directory, 'submaps.json')
        # A relative path is one below the nodes' working directory.
        launch = self.play('first', save_map=os.path.relpath(submaps, os.path.realpath(rospkg.get_ros_home())))
        try:
            self.assertTrue(wait_until(lambda: os.path.exists(submaps), 10), launch.output())
            with open(submaps, 'rb') as file:
                at_end = file.read()
            os.remove(submaps)
            answer = rospy.ServiceProxy('/%s/loop_detection/save_map' % PACKAGE, Trigger)()
            self.assertTrue(answer.success, answer.message)
            self.assertEqual(os.path.realpath(answer.message), os.path.realpath(submaps))
            self.assertTrue(os.path.isabs(answer.message), answer.message)
            with open(submaps, 'rb') as file:
                self.assertEqual(file.read(), at_end)
        finally:
            launch.stop()
        self.assertGreater(len(json.loads(at_end.decode())['submaps']), 1)

        launch = self.play('second', map=submaps)
        try:
            transform = rospy.wait_for_message('/%s/earlier_map_from_odom' % PACKAGE, TransformStamped, 10)
            answer = rospy.ServiceProxy('/%s/loop_detection/save_map' % PACKAGE, Trigger)()
        finally:
            launch.stop()
        # The same odometry twice: both runs begin at the origin of their maps.
        translation = transform.transform.translation
        self.assertLess(max(abs(translation.x), abs(translation.y), abs(translation.z)), 0.15, transform)
        self.assertGreater(abs(transform.transform.rotation.w), 0.999, transform)
        self.assertEqual((transform.header.frame_id, transform.child_frame_id), ('earlier_map', 'odom'))
        results = os.path.join(self.directory, 'second', 'results')
        self.assertTrue(wait_until(lambda: os.path.exists(os.path.join(results, 'relocalisations.csv')), 10))
        with open(os.path.join(results, 'summary.json')) as file:
            self.assertGreaterEqual(json.load(file)['relocalisation']['agreeing'], 3)
        self.assertFalse(answer.success)
        self.assertIn("parameter 'save_map_file' is empty", answer.message)

    def test_a_file_that_is_none_is_named(self):
        launch = demo(duration='4', data=os.path.join(self.directory, 'none'),
                      map=os.path.join(self.directory, 'no_such_file.json'))
        try:
            self.assertTrue(wait_until(lambda: 'LoopDetection is not working' in launch.output(), 30), launch.output())
        finally:
            launch.stop()
        self.assertTrue(any('no_such_file.json' in line and 'FATAL' in line for line in launch.lines), launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'earlier_map', EarlierMapTest)
