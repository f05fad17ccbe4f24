#!/usr/bin/env python3
"""Objects in the last correction of a run with loops: the nodelets, told so by a file of parameters, and offline."""
import json
import os

import rospkg
import rostest

from playback import PACKAGE, DirectoryTest, demo, differing_files, run_program


class GraphObjectsTest(DirectoryTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.config = cls.path('with_loops.yaml')
        with open(os.path.join(rospkg.RosPack().get_path(PACKAGE), 'config/default.yaml')) as file:
            default = file.read()
        assert default.count('objects: "off"') == 1
        with open(cls.config, 'w') as file:
            file.write(default.replace('objects: "off"', 'objects: "with_loops"'))
        # Into the second lap, in which loops are closed.
        cls.launch = demo(duration='32', data=cls.path('data'), output=cls.path('lockstep'), config=cls.config)
        cls.ended = cls.launch.wait(100)
        cls.launch.stop()

    def run_offline(self, output, *arguments):
        data = self.path('data')
        status, text = run_program('offline', '--trajectory', os.path.join(data, 'odometry.txt'), '--detections',
                                   os.path.join(data, 'detections.json'), '--camera',
                                   os.path.join(data, 'camera.yaml'), '--output', self.path(output), *arguments)
        self.assertEqual(status, 0, text)

    def test_lockstep_is_offline_byte_for_byte(self):
        self.assertTrue(self.ended and self.launch.player_finished(), self.launch.output())
        self.run_offline('offline', '--config', self.config)
        self.assertEqual(differing_files(self.path('offline'), self.path('lockstep')), [])
        with open(self.path('lockstep/summary.json')) as file:
            self.assertGreater(json.load(file)['loops']['kept'], 5)
        self.run_offline('without')
        differing = differing_files(self.path('without'), self.path('lockstep'))
        self.assertIn('trajectory.txt', differing, 'the objects took part')
        self.assertNotIn('trajectory_live.txt', differing, 'only at the end')


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'graph_objects', GraphObjectsTest)
