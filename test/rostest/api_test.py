#!/usr/bin/env python3
"""docs/ros_api.md against the nodelets: each is loaded by itself, in every way that changes what it says and hears, and
what the master and its services then show is what the page names; nothing less, nothing more."""
import io
import os
import re
import socket
import subprocess

import rosgraph
import rosgraph.network
import rospkg
import rospy
import rostest

from playback import PACKAGE, DirectoryTest, wait_until
from semantic_topo_loop.msg import DetectionArray
from wall import camera_yaml

NODELETS = re.compile(r'<class name="%s/(\w+)"' % PACKAGE)
ROW = re.compile(r'^\| (publishes|subscribes|serves) \| `([^`]+)` \| `([^`]+)` \|')
LIVE = {'ObjectDetector', 'ObjectAssociation', 'QuadricMapping', 'LoopDetection', 'PoseGraph', 'Visualization'}
# What is only there for a moment, or while a topic has listeners: named by the page, and not to be seen here.
PASSING = {('ObjectAssociation', 'subscribes', 'quadric_map'), ('Visualization', 'subscribes', 'quadric_map')}


def setUpModule():
    rospy.init_node('api_test')


def read(*path):
    with open(os.path.join(rospkg.RosPack().get_path(PACKAGE), *path)) as file:
        return file.read()


def documented():
    """Of each heading the set of its rows (verb, name, type)."""
    pages, heading = {}, None
    for line in read('docs', 'ros_api.md').splitlines():
        if line.startswith('## '):
            heading = line[3:]
        row = ROW.match(line)
        if row:
            pages.setdefault(heading, set()).add(row.groups())
    return pages


def service_type(service, uri):
    """Asked of the service itself: the master does not know."""
    host, port = rosgraph.network.parse_http_host_and_port(uri.replace('rosrpc', 'http'))
    with socket.create_connection((host, port), 5) as connection:
        rosgraph.network.write_ros_handshake_header(
            connection, {'probe': '1', 'md5sum': '*', 'callerid': rospy.get_name(), 'service': service})
        return rosgraph.network.read_ros_handshake_header(connection, io.BytesIO(), 4096)['type']


class ApiTest(DirectoryTest):
    """The nodelets' processes, started together: most of their time they load libraries."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.page = documented()
        cls.names = NODELETS.findall(read('nodelets.xml'))
        with open(cls.path('camera.yaml'), 'w') as file:
            file.write(camera_yaml())
        model = os.path.join(os.environ.get('SEMANTIC_TOPO_LOOP_DATA', ''), 'models', 'yolox_nano.onnx')
        own = {
            'PoseFrontend': {'pose_source': 'odometry', 'trigger': 'detections', 'use_points': True,
                             'publish_odom_tf': True},
            'RgbdFrontend': {'publish_odom_tf': True},
            'ObjectDetector': {'detector/model': model},
            'MapDatabase': {'save_map_file': cls.path('map.db')},
            'Recorder': {'output_dir': cls.path('results')},
            'Player': {'mode': 'bag', 'bag_file': cls.path('none.bag'), 'images': True,
                       'camera_file': cls.path('camera.yaml')}}
        rospy.set_param('/use_sim_time', True)
        classes = os.path.join(rospkg.RosPack().get_path(PACKAGE), 'config', 'classes_coco.yaml')
        cls.processes, cls.outputs = [], {}
        # What is made while somebody listens.
        cls.peers = [rospy.Subscriber('/%s/%s' % (PACKAGE, topic), rospy.AnyMsg, lambda message: None)
                         for topic in ('markers/keyframes', 'markers/topology', 'annotated_image')]
        # Who takes boxes takes several types, and without a model no ObjectDetector says which it sends.
        cls.peers.append(rospy.Publisher('/%s/detections_in' % PACKAGE, DetectionArray, queue_size=1))
        for name in cls.names:
            for key, value in own.get(name, {}).items():
                rospy.set_param('/%s/%s/%s' % (PACKAGE, name, key), value)
            if name != 'Player':
                rospy.set_param('/%s/%s/class_table' % (PACKAGE, name), classes)
            cls.outputs[name] = open(cls.path(name), 'w+')
            cls.processes.append(subprocess.Popen(
                ['rosrun', 'nodelet', 'nodelet', 'standalone', '%s/%s' % (PACKAGE, name), '__name:=' + name,
                 '__ns:=/' + PACKAGE], stdout=cls.outputs[name], stderr=subprocess.STDOUT))

    @classmethod
    def tearDownClass(cls):
        for process in cls.processes:
            process.terminate()
        for process in cls.processes:
            process.wait(30)
        for output in cls.outputs.values():
            output.close()
        for peer in cls.peers:
            peer.unregister()
        rospy.delete_param('/use_sim_time')
        super().tearDownClass()

    def seen(self, name):
        """The rows (verb, name, type) of a nodelet, as the master knows it."""
        node, prefix = '/%s/%s' % (PACKAGE, name), '/%s/' % PACKAGE

        def short(name):
            return name.replace(node + '/', '~').replace(prefix, '')

        def is_own(name, nodes):
            # Below an image's name are those of image_transport's plugins, where some are installed.
            return node in nodes and '/annotated_image/' not in name

        master = rosgraph.Master(rospy.get_name())
        types = dict(master.getTopicTypes())
        rows = set()
        for verb, topics in zip(('publishes', 'subscribes'), master.getSystemState()):
            rows |= {(verb, short(topic), types.get(topic)) for topic, nodes in topics if is_own(topic, nodes)}
        for service, nodes in master.getSystemState()[2]:
            if is_own(service, nodes):
                rows.add(('serves', short(service), service_type(service, master.lookupService(service))))
        return rows

    def expected(self, name):
        follows = name not in ('PoseFrontend', 'RgbdFrontend', 'Player')
        rows = self.page[name] | self.page['Every nodelet'] | (self.page['Every stage'] if follows else set())
        if name in LIVE:
            rows |= self.page['Live settings']
        return {row for row in rows if (name,) + row[:2] not in PASSING}

    def output(self, name):
        with open(self.path(name)) as file:
            return file.read()

    def test_headings_are_the_nodelets(self):
        self.assertEqual(sorted(set(self.page) - {'Every nodelet', 'Every stage', 'Live settings'}), sorted(self.names))

    def is_without_model(self, name):
        """No recorded data, or a version of OpenCV that does not read its networks."""
        return name == 'ObjectDetector' and 'cannot be read as an ONNX model' in self.output(name)

    def differences(self):
        """By nodelet: what is documented and not there, and what is there and not documented."""
        differences = {}
        for name in self.names:
            seen, expected = self.seen(name), self.expected(name)
            if seen != expected and not self.is_without_model(name):
                differences[name] = {'missing': expected - seen, 'undocumented': seen - expected}
        return differences

    def test_each_nodelet_is_as_documented(self):
        wait_until(lambda: not self.differences(), 60)
        differences = self.differences()
        self.assertFalse(differences, '%s: %s' % (differences, [self.output(name) for name in differences]))


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'api', ApiTest)
