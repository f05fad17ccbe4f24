#!/usr/bin/env python3
"""The launch file of docs/tutorial.md, word for word, on a bag as it describes."""
import json
import os
import re

import rosbag
import rospkg
import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from playback import PACKAGE, DirectoryTest, Launch, run_program
from vision_msgs.msg import Detection2D, Detection2DArray, ObjectHypothesisWithPose

MOST_LINES = 15
WIDTH, HEIGHT, FOCAL = 320, 240, 262.5
ROOT = 'camera_link'  # of the driver's tf


def setUpModule():
    rospy.init_node('tutorial_test')


def launch_file_of_tutorial():
    with open(os.path.join(rospkg.RosPack().get_path(PACKAGE), 'docs/tutorial.md')) as file:
        return re.search(r'^```xml\n(<launch>\n.*?</launch>\n)```$', file.read(), re.DOTALL | re.MULTILINE).group(1)


def topic_in(launch, name):
    return re.search('<arg name="%s" value="(.*?)"' % name, launch).group(1)


def driver_tf(frame):
    """The optical frame as a camera's driver hangs it up."""
    edge = TransformStamped(child_frame_id=frame)
    edge.header.frame_id = ROOT
    edge.transform.translation.x = 0.02
    edge.transform.rotation.x, edge.transform.rotation.y, edge.transform.rotation.z, edge.transform.rotation.w = (
        -0.5, 0.5, -0.5, 0.5)
    return TFMessage([edge])


def detected(image):
    """An image of detections.json as a message."""
    message = Detection2DArray()
    seconds, nanoseconds = os.path.splitext(image['file_name'])[0].split('.')
    message.header.stamp = rospy.Time(int(seconds), int(nanoseconds.ljust(9, '0')))
    for box in image['detections']:
        x1, y1, x2, y2 = box['bbox']
        detection = Detection2D(results=[ObjectHypothesisWithPose(id=box['category_id'], score=box['detection_score'])])
        detection.bbox.center.x, detection.bbox.center.y = (x1 + x2) / 2.0, (y1 + y2) / 2.0
        detection.bbox.size_x, detection.bbox.size_y = x2 - x1, y2 - y1
        message.detections.append(detection)
    return message


class TutorialTest(DirectoryTest):
    def write_bag(self, launch):
        """A rendered recording with the launch file's topics and the driver's tf, and nothing else."""
        with open(self.path('camera.yaml'), 'w') as file:
            file.write('fx: %g\nfy: %g\ncx: 160\ncy: 120\nwidth: %d\nheight: %d\ndistortion: [0, 0, 0, 0, 0]\n' % (
                FOCAL, FOCAL, WIDTH, HEIGHT))
        status, text = run_program('simulate_bag', '--output', self.path('sim'), '--camera', self.path('camera.yaml'),
                                   '--seed', '5', '--duration', '8', '--rate', '15', '--set', 'trajectory.lap_s=25')
        self.assertEqual(status, 0, text)
        own = {'/camera/rgb/image_color': 'color', '/camera/depth/image': 'depth',
               '/camera/rgb/camera_info': 'camera_info'}
        with open(self.path('sim/detections.json')) as file:
            messages = {message.header.stamp: message for message in map(detected, json.load(file))}
        images = 0
        with rosbag.Bag(self.path('my.bag'), 'w') as bag:
            for i, (topic, message, time) in enumerate(
                    rosbag.Bag(self.path('sim/sequence.bag')).read_messages(topics=own)):
                if i == 0:
                    bag.write('/tf_static', driver_tf(message.header.frame_id), time)
                if topic.endswith('camera_info'):
                    message.K = [FOCAL, 0.0, 160.0, 0.0, FOCAL, 120.0, 0.0, 0.0, 1.0]
                bag.write(topic_in(launch, own[topic]), message, time)
                if own[topic] == 'color':
                    images += 1
                    answered = time + rospy.Duration(0.1)
                    bag.write(topic_in(launch, 'detections'), messages[message.header.stamp], answered)
        return images

    def test_the_launch_file_maps_a_bag(self):
        launch_file = launch_file_of_tutorial()
        self.assertLessEqual(len(launch_file.splitlines()), MOST_LINES)
        with open(self.path('my_bag.launch'), 'w') as file:
            file.write(launch_file)
        images = self.write_bag(launch_file)
        edges = set()
        tf = rospy.Subscriber('/tf', TFMessage, lambda message: edges.update(
            (edge.header.frame_id, edge.child_frame_id) for edge in message.transforms))
        launch = Launch(self.path('my_bag.launch'), bag=self.path('my.bag'), output=self.path('map'), rviz='false')
        ended = launch.wait(120)
        launch.stop()
        tf.unregister()
        self.assertTrue(ended, launch.output())
        self.assertEqual({edge for edge in edges if edge[0] == 'odom'}, {('odom', ROOT)}, 'no second parent for the camera')
        with open(self.path('map/summary.json')) as file:
            summary = json.load(file)
        # Those that came before every stage was up are missing.
        self.assertGreater(summary['frames'], images // 2, launch.output())
        self.assertGreater(summary['detections'], summary['frames'], 'more than one box an image')
        with open(self.path('map/objects.csv')) as file:
            self.assertGreater(len(file.readlines()), 3, launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'tutorial', 'tutorial_test')
