"""A live robot's topics, for slam.launch: what it publishes, and what it hears back."""
import threading
import unittest

import rospy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from playback import PACKAGE, Diagnostics, Launch, wait_until
from semantic_topo_loop.msg import Detection, DetectionArray, Frame, FrameDone, SessionControl

START_S = 1000.0
CUP = 41


class Topic:
    """Every message of a topic, in order."""

    def __init__(self, name, kind):
        self.messages = []
        self.lock = threading.Lock()
        self.subscriber = rospy.Subscriber('/%s/%s' % (PACKAGE, name), kind, self.take, queue_size=1000)

    def take(self, message):
        with self.lock:
            self.messages.append(message)

    def at(self, time_s):
        """The last message with this stamp, waited for (topics arrive in no order among each other), or None."""
        stamp = rospy.Time.from_sec(START_S + time_s)

        def found():
            with self.lock:
                return [m for m in self.messages if m.header.stamp == stamp]

        return found()[-1] if wait_until(found, 10) else None


class LiveFeed(unittest.TestCase):
    """Base of the tests: slam.launch with `arguments`, and its topics."""
    arguments = {}

    @classmethod
    def setUpClass(cls):
        rospy.init_node('live_feed')
        cls.launch = Launch('slam.launch', camera_info='/camera_info', detections='/detector', odometry='/odometry',
                            points='/cloud', detection_timeout_s='0.4', pose_timeout_s='0.4', **cls.arguments)
        cls.tf = rospy.Publisher('/tf', TFMessage, queue_size=1000)
        cls.tf_static = rospy.Publisher('/tf_static', TFMessage, queue_size=10, latch=True)
        cls.odometry = rospy.Publisher('/odometry', Odometry, queue_size=1000)
        cls.cloud = rospy.Publisher('/cloud', PointCloud2, queue_size=100)
        cls.camera_info = rospy.Publisher('/camera_info', CameraInfo, queue_size=100)
        cls.detections = rospy.Publisher('/detector', DetectionArray, queue_size=100)
        cls.frames = Topic('frames', Frame)
        cls.joined = Topic('detections', DetectionArray)
        cls.done = Topic('frame_done', FrameDone)
        cls.control = Topic('session_control', SessionControl)
        cls.diagnostics = Diagnostics()
        extrinsics = cls.transform('/base_link', '/lens', 0.0, 0.0)
        cls.tf_static.publish(TFMessage([extrinsics]))
        publishers = [cls.tf, cls.tf_static, cls.camera_info, cls.detections]
        publishers += [cls.odometry] if 'pose_source' in cls.arguments else []
        publishers += [cls.cloud] if 'use_points' in cls.arguments else []
        up = wait_until(lambda: cls.control.messages and all(p.get_num_connections() > 0 for p in publishers), 40)
        assert up, cls.launch.output()

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()

    @staticmethod
    def transform(parent, child, time_s, x):
        message = TransformStamped()
        message.header.frame_id = parent
        message.header.stamp = rospy.Time.from_sec(START_S + time_s)
        message.child_frame_id = child
        message.transform.translation.x = x
        message.transform.rotation.w = 1.0
        return message

    def move(self, begin_s, end_s):
        """1 m/s along x, sampled at 50 Hz."""
        for i in range(round(50 * begin_s), round(50 * end_s) + 1):
            self.tf.publish(TFMessage([self.transform('/odom', '/base_link', i / 50.0, i / 50.0)]))

    def see(self, time_s, with_detections=True, boxes=((100, 100, 200, 200),), focal_length=500.0):
        info = CameraInfo(width=640, height=480, distortion_model='plumb_bob', D=[0.0] * 5)
        info.header.frame_id = '/lens'
        info.header.stamp = rospy.Time.from_sec(START_S + time_s)
        info.K = [focal_length, 0.0, 320.0, 0.0, focal_length, 240.0, 0.0, 0.0, 1.0]
        self.camera_info.publish(info)
        if not with_detections:
            return
        message = DetectionArray()
        message.header.stamp = info.header.stamp
        for x1, y1, x2, y2 in boxes:
            detection = Detection(class_id=CUP, score=0.9)
            detection.box.x1, detection.box.y1, detection.box.x2, detection.box.y2 = x1, y1, x2, y2
            message.detections.append(detection)
        self.detections.publish(message)

    def assert_status(self, time_s, status):
        answer = self.done.at(time_s)
        self.assertIsNotNone(answer, 'no answer for %s' % time_s)
        self.assertEqual(answer.status, status, time_s)

    def assert_counted(self, stage, key, least=1):
        self.assertTrue(wait_until(lambda: self.diagnostics.count(stage, key) >= least, 10),
                        '%s: %s is %g' % (stage, key, self.diagnostics.count(stage, key)))

    def call(self, service):
        name = '/%s/pose_frontend/%s' % (PACKAGE, service)
        self.assertTrue(rospy.ServiceProxy(name, Trigger)().success)
