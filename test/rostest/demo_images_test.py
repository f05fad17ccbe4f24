#!/usr/bin/env python3
"""demo.launch as users start it: rendered images, whose odometry drifts, revisits, loops, and a corrected trajectory."""
import json
import os

import rospy
import rostest

from playback import PACKAGE, RESULT_FILES, DirectoryTest, Launch, differing_files, rows_of, run_program


def setUpModule():
    rospy.init_node('demo_images_test')


class DemoTest(DirectoryTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.data, cls.results = cls.path('data'), cls.path('data/results')
        cls.map = cls.path('map.db')
        cls.launch = Launch('demo.launch', rviz='false', data=cls.data, save_map=cls.map)
        cls.ended = cls.launch.wait(540)
        cls.launch.stop()

    def evaluate(self, kind, *arguments):
        """The figures of `evaluate`."""
        figures = self.path(kind + '.json')
        status, text = run_program('evaluate', kind, *arguments, '--json', figures)
        self.assertEqual(status, 0, text)
        with open(figures) as file:
            return json.load(file)

    def ate_m(self, trajectory):
        return self.evaluate('trajectory', os.path.join(self.results, trajectory),
                             os.path.join(self.data, 'groundtruth.txt'))['ate_m']['rmse']

    def test_plays_to_the_end_and_leaves_every_file(self):
        self.assertTrue(self.ended and self.launch.player_finished(), self.launch.output())
        self.assertEqual(sorted(os.listdir(self.results)), sorted(RESULT_FILES))

    def test_gives_the_offline_result_with_its_loops(self):
        inputs = {'--' + name: os.path.join(self.data, file) for name, file in (
            ('bag', 'sequence.bag'), ('camera', 'camera.yaml'), ('detections', 'detections.json'))}
        status, text = run_program('offline', *sum(inputs.items(), ()), '--output', self.path('offline'), '--save-map',
                                   self.path('offline.db'))
        self.assertEqual(status, 0, text)
        self.assertEqual(differing_files(self.path('offline'), self.results), [])
        rows = rows_of(self, self.map)
        self.assertGreater(sum(row.startswith('points ') for row in rows), 20, 'keyframes with points')
        self.assertTrue(rows == rows_of(self, self.path('offline.db')), 'the map of the nodelets is another')

    def test_closes_loops_where_places_are_revisited(self):
        loops = self.evaluate('loops', self.results, os.path.join(self.data, 'groundtruth_frames.txt'))
        self.assertGreater(loops['accepted'], 50)
        self.assertGreater(loops['right_wide']['value'], 0.99)
        self.assertGreater(loops['closed']['total'], 10, 'queries that revisit a place')
        self.assertGreater(loops['closed']['value'], 0.3)

    def test_corrects_a_drift_that_can_be_seen(self):
        live_m, corrected_m = self.ate_m('trajectory_live.txt'), self.ate_m('trajectory.txt')
        self.assertGreater(live_m, 0.05)
        self.assertLess(corrected_m, 0.7 * live_m)

    def test_maps_objects(self):
        objects = self.evaluate('objects', self.results, os.path.join(self.data, 'groundtruth.txt'),
                                os.path.join(self.data, 'reference_objects.csv'))
        self.assertGreater(objects['certain']['f'], 0.7)


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'demo_images', 'demo_images_test')
