#!/usr/bin/env python3
"""The recorded fr2_desk through fr2_desk.launch: offline's bytes, and the figures that the package promises.

`fr2_desk_test.py --rostest DIR` starts it in a rostest whose result goes to DIR, or ends with 77, ctest's skipped,
without the recording: rostest knows no skipped test."""
import json
import os
import sys

import rospkg
import rostest

from playback import PACKAGE, DirectoryTest, Launch, differing_files, run_program

DATA = os.environ.get('SEMANTIC_TOPO_LOOP_DATA', '')
RECORDED = ('orbslam2_rgbd_trajectory.txt', 'detections_yolov5.json', 'groundtruth_frames.txt', 'reference_objects.csv')


class Fr2DeskTest(DirectoryTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.results = cls.path('results')
        cls.launch = Launch('fr2_desk.launch', data=DATA, output=cls.results)
        cls.ended = cls.launch.wait(150)
        cls.launch.stop()

    def recorded(self, name):
        return os.path.join(DATA, 'tum/fr2_desk', name)

    def evaluate(self, *arguments):
        file = self.path('figures.json')
        status, output = run_program('evaluate', *arguments, '--json', file)
        self.assertEqual(status, 0, output)
        with open(file) as figures:
            return json.load(figures)

    def test_ends_by_itself(self):
        self.assertTrue(self.ended, self.launch.output())
        self.assertTrue(self.launch.player_finished(), self.launch.output())

    def test_is_offline_byte_for_byte(self):
        offline = self.path('offline')
        config = os.path.join(rospkg.RosPack().get_path(PACKAGE), 'config')
        status, output = run_program('offline', '--trajectory', self.recorded('orbslam2_rgbd_trajectory.txt'),
                                     '--detections', self.recorded('detections_yolov5.json'),
                                     '--camera', os.path.join(config, 'camera/tum_fr2.yaml'),
                                     '--config', os.path.join(config, 'default.yaml'), '--output', offline)
        self.assertEqual(status, 0, output)
        self.assertEqual(differing_files(offline, self.results), [])

    def test_keeps_the_trajectory(self):
        figures = self.evaluate('trajectory', os.path.join(self.results, 'trajectory.txt'),
                                self.recorded('groundtruth.txt'))
        self.assertLessEqual(figures['ate_m']['rmse'], 0.0079)  # 0.0081 of the odometry

    def test_finds_the_objects(self):
        figures = self.evaluate('objects', self.results, self.recorded('groundtruth_frames.txt'),
                                self.recorded('reference_objects.csv'))
        self.assertGreaterEqual(figures['certain']['f'], 0.97)

    def test_closes_right_loops(self):
        figures = self.evaluate('loops', self.results, self.recorded('groundtruth_frames.txt'))
        right = figures['right_wide']
        self.assertGreaterEqual(right['right'], 400)
        self.assertGreater(right['right'], 0.99 * right['total'])


def start_rostest(results):
    if all(os.path.exists(os.path.join(DATA, 'tum/fr2_desk', name)) for name in RECORDED):
        os.execvp('rostest', ['rostest', '--results-base-dir', results, '--results-filename', 'rostest_fr2_desk.xml',
                              os.path.join(os.path.dirname(os.path.abspath(__file__)), 'run.test'), 'name:=fr2_desk'])
    print("SKIPPED: tum/fr2_desk in SEMANTIC_TOPO_LOOP_DATA='%s' lacks one of %s" % (DATA, ', '.join(RECORDED)))
    os.makedirs(results, exist_ok=True)
    with open(os.path.join(results, 'rostest_fr2_desk.xml'), 'w') as file:
        file.write('<testsuite name="fr2_desk" tests="1" skipped="1"><testcase name="fr2_desk"><skipped/></testcase>'
                   '</testsuite>\n')
    sys.exit(77)


if __name__ == '__main__':
    if sys.argv[1:2] == ['--rostest']:
        start_rostest(sys.argv[2])
    rostest.rosrun(PACKAGE, 'fr2_desk', Fr2DeskTest)
