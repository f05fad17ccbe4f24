#!/usr/bin/env python3
"""A simulated bag in the TUM layout through tum.launch: poses from the motion capture, and from a file."""
import os
import shutil
import tempfile
import threading
import unittest

import rosbag
import rospy
import rostest
from tf2_msgs.msg import TFMessage

from playback import PACKAGE, Launch, differing_files, run_program


def read_poses(path):
    with open(path) as file:
        rows = [line.split() for line in file if line.strip() and not line.startswith('#')]
    return {row[0]: [float(value) for value in row[1:4]] for row in rows}


class TumBagTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('tum_bag_test')
        cls.directory = tempfile.mkdtemp(prefix='semantic_topo_loop_tum_')
        cls.bag = os.path.join(cls.directory, 'simulated.bag')
        status, output = run_program('simulate', '--output', cls.directory, '--duration', '10', '--bag', cls.bag)
        assert status == 0, output
        cls.lock = threading.Lock()
        cls.parents = {}
        rospy.Subscriber('/tf', TFMessage, cls.take_tf, queue_size=10000)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.directory)

    @classmethod
    def take_tf(cls, message):
        with cls.lock:
            for transform in message.transforms:
                cls.parents.setdefault(transform.child_frame_id, set()).add(transform.header.frame_id)

    def path(self, name):
        return os.path.join(self.directory, name)

    def play(self, output, **arguments):
        with self.lock:
            self.parents.clear()
        launch = Launch('tum.launch', bag=self.bag, detections=self.path('detections.json'),
                        camera=self.path('camera.yaml'), output=self.path(output), **arguments)
        ended = launch.wait(90)
        launch.stop()
        self.assertTrue(ended and launch.player_finished(), launch.output())
        # Nobody has two parents, and no name has the slash that tf2 refuses.
        with self.lock:
            self.assertEqual({child: len(parents) for child, parents in self.parents.items() if len(parents) > 1}, {})
            self.assertFalse([name for name in self.parents if name.startswith('/')])
            return {(parent, child) for child, parents in self.parents.items() for parent in parents}

    def test_poses_from_the_motion_capture(self):
        edges = self.play('mocap', poses='mocap')
        self.assertIn(('odom', 'kinect'), edges)
        self.assertIn(('kinect', 'openni_camera'), edges)
        live = read_poses(self.path('mocap/trajectory_live.txt'))
        truth = read_poses(self.path('groundtruth_frames.txt'))
        self.assertGreaterEqual(len(live), len(truth) - 10)
        for stamp, position in live.items():
            distance = sum((a - b) ** 2 for a, b in zip(position, truth[stamp])) ** 0.5
            self.assertLess(distance, 0.01, stamp)

    def test_poses_from_a_file_give_the_offline_result(self):
        odometry = self.path('odometry.txt')
        edges = self.play('file', poses='file', trajectory=odometry)
        self.assertIn(('odom', 'kinect'), edges)
        self.assertNotIn(('world', 'kinect'), edges)
        status, output = run_program('offline', '--trajectory', odometry, '--detections', self.path('detections.json'),
                                     '--camera', self.path('camera.yaml'), '--output', self.path('offline'))
        self.assertEqual(status, 0, output)
        self.assertEqual(differing_files(self.path('offline'), self.path('file')), [])

    def test_a_damaged_bag_is_one_error_and_keeps_what_was_mapped(self):
        damaged = self.path('damaged.bag')
        with rosbag.Bag(self.bag) as whole:
            with rosbag.Bag(damaged, 'w', compression='bz2', chunk_threshold=20000) as copy:
                for topic, message, time in whole.read_messages():
                    copy.write(topic, message, time)
        with open(damaged, 'r+b') as file:
            # Inside the data of a compressed chunk; the records around it tell where everything is.
            content = file.read()
            file.seek(content.index(b'BZh', len(content) // 2) + 100)
            file.write(b'\xff' * 100)
        launch = Launch('tum.launch', bag=damaged, detections=self.path('detections.json'), poses='file',
                        trajectory=self.path('odometry.txt'), camera=self.path('camera.yaml'),
                        output=self.path('damaged'))
        ended = launch.wait(90)
        launch.stop()
        text = launch.output()
        self.assertTrue(ended, text)
        self.assertIn('exit code 1', text)
        self.assertEqual(text.count('the recording ends early'), 1, text)
        frames = len(read_poses(self.path('damaged/trajectory.txt')))
        self.assertGreater(frames, 10)
        self.assertLess(frames, len(read_poses(self.path('odometry.txt'))))

    def test_a_cut_bag_is_one_error(self):
        cut = self.path('cut.bag')
        shutil.copy(self.bag, cut)
        os.truncate(cut, os.path.getsize(cut) // 2)
        launch = Launch('tum.launch', bag=cut, detections=self.path('detections.json'), poses='mocap',
                        camera=self.path('camera.yaml'), output=self.path('cut'))
        ended = launch.wait(60)
        launch.stop()
        self.assertTrue(ended, launch.output())
        fatal = [line for line in launch.lines if 'cut.bag' in line and 'not working' in line]
        self.assertEqual(len(fatal), 1, launch.output())
        self.assertIn('exit code 1', launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'tum_bag', TumBagTest)
