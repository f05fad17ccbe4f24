#!/usr/bin/env python3
"""The chain in a nodelet manager that somebody else started, as a camera driver's: images reach it without a copy."""
import subprocess
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest

import wall
from bag_test import record
from playback import PACKAGE, DirectoryTest, Launch, Listener, wait_until

MANAGER = '/camera/driver'


def setUpModule():
    rospy.init_node('manager_test')


def publishers(topic):
    """The nodes that publish a topic."""
    return dict(rosgraph.Master(rospy.get_name()).getSystemState()[0]).get(topic, [])


class ManagerTest(DirectoryTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.driver = subprocess.Popen(['rosrun', 'nodelet', 'nodelet', 'manager', '__name:=driver', '__ns:=/camera'])
        rospy.wait_for_service(MANAGER + '/list', 30)

    @classmethod
    def tearDownClass(cls):
        cls.driver.terminate()
        cls.driver.wait(10)
        super().tearDownClass()

    def assert_manager_is_the_drivers(self):
        self.assertNotIn('/%s/manager' % PACKAGE, publishers('/rosout'))
        self.assertIsNone(self.driver.poll(), 'the driver goes on')

    def transports(self, topic):
        """How a topic leaves the manager."""
        _, _, links = ServerProxy(rosgraph.Master(rospy.get_name()).lookupNode(MANAGER)).getBusInfo(rospy.get_name())
        return [link[3] for link in links if link[4] == topic and link[2] == 'o']

    def test_images_are_not_copied(self):
        bag = self.path('wall.bag')
        record(bag, 20)
        with open(self.path('camera.yaml'), 'w') as file:
            file.write(wall.camera_yaml())
        listener = Listener()
        # The player stands for the driver.
        launch = Launch('tum.launch', bag=bag, camera=self.path('camera.yaml'), output=self.path('results'),
                        manager=MANAGER, wait_for='Listener')
        try:
            self.assertTrue(wait_until(listener.is_connected, 60), launch.output())
            for topic in ('color', 'depth', 'frames'):
                transports = self.transports('/%s/%s' % (PACKAGE, topic))
                self.assertTrue(transports, topic)
                self.assertEqual(set(transports), {'INTRAPROCESS'}, topic)
            self.assert_manager_is_the_drivers()
            self.assertTrue(listener.let_begin(), launch.output())
            self.assertTrue(launch.wait(60), launch.output())
        finally:
            launch.stop()
            listener.close()
        self.assertTrue(launch.player_finished(), launch.output())
        with open(self.path('results/trajectory.txt')) as file:
            self.assertEqual(len([line for line in file if not line.startswith('#')]), 20)
        self.assert_manager_is_the_drivers()

    def test_slam_launch_joins_and_leaves(self):
        launch = Launch('slam.launch', pose_source='rgbd', use_detections='false', manager=MANAGER)
        try:
            for topic in ('frames', 'detections', 'map_corrections'):
                name = '/%s/%s' % (PACKAGE, topic)
                self.assertTrue(wait_until(lambda: publishers(name) == [MANAGER], 60), launch.output())
            self.assert_manager_is_the_drivers()
        finally:
            launch.stop()
        self.assertTrue(wait_until(lambda: not publishers('/%s/frames' % PACKAGE), 15), 'the chain is unloaded')
        self.assert_manager_is_the_drivers()


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'manager', 'manager_test')
