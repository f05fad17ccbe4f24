#!/usr/bin/env python3
"""demo.launch from end to end: it says what it must on its topics, and leaves offline's files."""
import csv
import os
import shutil
import tempfile
import threading
import unittest

import rospy
import rostest
from nav_msgs.msg import Path
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from playback import PACKAGE, RESULT_FILES, demo, differing_files, run_program, wait_until
from semantic_topo_loop.msg import FrameDone, QuadricMap
from semantic_topo_loop.srv import WhyLoop, WhyLoopResponse


class Heard:
    """What was published on the topics that users look at."""

    def __init__(self):
        self.lock = threading.Lock()
        self.done = []
        self.edges = set()
        self.last = {}
        rospy.Subscriber('/tf', TFMessage, self.take_tf)
        rospy.Subscriber('/%s/frame_done' % PACKAGE, FrameDone, self.take_done, queue_size=10000)
        for topic, kind in [('path_odometry', Path), ('path_corrected', Path), ('quadric_map', QuadricMap),
                            ('markers/quadrics', MarkerArray), ('markers/labels', MarkerArray),
                            ('markers/keyframes', MarkerArray)]:
            rospy.Subscriber('/%s/%s' % (PACKAGE, topic), kind, self.take, topic)

    def take_tf(self, message):
        with self.lock:
            self.edges |= {(t.header.frame_id, t.child_frame_id) for t in message.transforms}

    def take_done(self, message):
        with self.lock:
            self.done.append(message)

    def take(self, message, topic):
        with self.lock:
            self.last[topic] = message


class DemoTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('demo_test')
        cls.directory = tempfile.mkdtemp(prefix='semantic_topo_loop_demo_')
        cls.data = os.path.join(cls.directory, 'data')
        cls.results = os.path.join(cls.directory, 'results')
        cls.submaps = os.path.join(cls.directory, 'submaps.json')
        cls.heard = Heard()
        # It stays up at the end, so that what is published at intervals can be heard.
        cls.launch = demo(duration='16', data=cls.data, output=cls.results, exit_at_end='false', save_map=cls.submaps)
        cls.status, cls.said = run_program('wait_for_player', '__ns:=/' + PACKAGE, timeout_s=90)

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()
        shutil.rmtree(cls.directory)

    def test_plays_to_the_end_and_leaves_every_file(self):
        self.assertEqual(self.status, 0, self.launch.output())
        self.assertIn('player: finished', self.said)
        self.assertEqual(sorted(os.listdir(self.results)), sorted(RESULT_FILES))

    def test_maps_objects(self):
        with open(os.path.join(self.results, 'objects.csv')) as file:
            states = [row['state'] for row in csv.DictReader(file)]
        self.assertGreaterEqual(states.count('confirmed'), 3, states)

    def test_answers_every_image_and_the_end(self):
        with open(os.path.join(self.data, 'odometry.txt')) as file:
            images = sum(1 for line in file if not line.startswith('#'))
        # The connection to us may have come up after the first images.
        ids = [done.frame_id for done in self.heard.done]
        self.assertLess(ids[0], images // 2)
        self.assertEqual(ids, list(range(ids[0], images + 1)))
        statuses = [done.status for done in self.heard.done]
        self.assertEqual(set(statuses[:-1]), {FrameDone.STATUS_PROCESSED})
        self.assertEqual(statuses[-1], FrameDone.STATUS_END)

    def test_publishes_what_rviz_shows(self):
        topics = {'path_odometry', 'path_corrected', 'quadric_map', 'markers/quadrics', 'markers/labels',
                  'markers/keyframes'}
        self.assertTrue(wait_until(lambda: topics <= set(self.heard.last), 10), set(self.heard.last))
        self.assertIn(('map', 'odom'), self.heard.edges)
        self.assertIn(('odom', 'camera_optical_frame'), self.heard.edges)
        self.assertGreater(len(self.heard.last['path_corrected'].poses), 10)
        self.assertGreater(len(self.heard.last['markers/quadrics'].markers), 3)

    def test_explains_pairs_of_keyframes(self):
        why_loop = rospy.ServiceProxy('/%s/loop_detection/why_loop' % PACKAGE, WhyLoop)
        with open(os.path.join(self.results, 'keyframes.csv')) as file:
            last = max(int(row['keyframe_id']) for row in csv.DictReader(file))
        answer = why_loop(last + 1, 0)
        self.assertEqual((answer.status, answer.has_closure), (WhyLoopResponse.STATUS_UNKNOWN_KEYFRAME, False))
        self.assertIn('keyframe %d is unknown: there are 0 to %d' % (last + 1, last), answer.explanation)
        self.assertEqual(why_loop(1, 2).status, WhyLoopResponse.STATUS_WRONG_ORDER)
        # All within loop.min_gap_s, so that the pair is compared for the answer.
        answers = [why_loop(last // 2 + k, k) for k in range(last // 2)]
        too_recent = [a for a in answers if a.status == WhyLoopResponse.STATUS_TOO_RECENT and a.has_closure]
        self.assertTrue(too_recent, [a.explanation for a in answers])
        self.assertIn('compared now', too_recent[0].explanation)
        self.assertGreaterEqual(too_recent[0].closure.inliers, 4)

    def test_lockstep_is_offline_byte_for_byte(self):
        offline, submaps = (os.path.join(self.directory, name) for name in ('offline', 'offline_submaps.json'))
        status, output = run_program('offline', '--trajectory', os.path.join(self.data, 'odometry.txt'),
                                     '--detections', os.path.join(self.data, 'detections.json'),
                                     '--camera', os.path.join(self.data, 'camera.yaml'), '--output', offline,
                                     '--save-map', submaps)
        self.assertEqual(status, 0, output)
        self.assertEqual(differing_files(offline, self.results), [])
        self.assertTrue(wait_until(lambda: os.path.exists(self.submaps), 10), self.launch.output())
        with open(submaps, 'rb') as ours, open(self.submaps, 'rb') as theirs:
            self.assertEqual(ours.read(), theirs.read())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'demo', DemoTest)
