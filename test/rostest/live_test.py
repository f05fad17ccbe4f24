#!/usr/bin/env python3
"""slam.launch on live topics that come from other processes, good ones and bad ones: tf with camera_info, odometry with
clouds, and an RGB-D camera alone."""
import math
import os
import struct
import threading
import time
import unittest

import rospkg
import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import Empty
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

import wall
from playback import PACKAGE, Diagnostics, Launch, wait_until
from darknet_ros_msgs.msg import BoundingBox, BoundingBoxes
from semantic_topo_loop.msg import Detection, DetectionArray, Frame, FrameDone, SessionControl

START_S = 1000.0
CUP = 41
STAGES = ('DetectionIngestion', 'ObjectAssociation', 'QuadricMapping', 'LoopDetection', 'PoseGraph')
DEPTH_DELAY_S = 0.006


def setUpModule():
    rospy.init_node('live_test')


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


class LiveTest(unittest.TestCase):
    """Base of the tests: slam.launch, what it says, and topics to publish on, none of them left for the next one."""

    @classmethod
    def start(cls, **arguments):
        cls.launch = Launch('slam.launch', **arguments)
        cls.frames, cls.joined = Topic('frames', Frame), Topic('detections', DetectionArray)
        cls.done, cls.control = Topic('frame_done', FrameDone), Topic('session_control', SessionControl)
        cls.diagnostics = Diagnostics()
        cls.publishers = []

    @classmethod
    def publisher(cls, topic, kind, latch=False):
        cls.publishers.append(rospy.Publisher(topic, kind, queue_size=1000, latch=latch))
        return cls.publishers[-1]

    @classmethod
    def wait_until_up(cls):
        ends = cls.publishers + [topic.subscriber for topic in (cls.frames, cls.joined, cls.done)]
        # A stage shows what it has heard once it has: before it knows the session it drops what comes.
        heard = [(stage, 'session_control rate') for stage in STAGES]
        up = wait_until(lambda: cls.control.messages and all(end.get_num_connections() > 0 for end in ends) and
                        all(key in cls.diagnostics.values for key in heard), 40)
        assert up, cls.launch.output()

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()
        for topic in (cls.frames, cls.joined, cls.done, cls.control, cls.diagnostics):
            topic.subscriber.unregister()
        for publisher in cls.publishers:
            publisher.unregister()

    def assert_status(self, time_s, status):
        answer = self.done.at(time_s)
        self.assertIsNotNone(answer, 'no answer for %s: %s' % (time_s, self.diagnostics.values))
        self.assertEqual(answer.status, status, time_s)

    def assert_counted(self, stage, key, least=1):
        self.assertTrue(wait_until(lambda: self.diagnostics.count(stage, key) >= least, 10),
                        '%s: %s: %s' % (stage, key, self.diagnostics.values))


class DetectorTest(LiveTest):
    """A camera whose images are known by their camera_info, with a detector, on a base that moves."""
    detector_type = DetectionArray

    @classmethod
    def start(cls, **arguments):
        super().start(camera_info='/camera_info', detections='/detector', odometry='/odometry', points='/cloud',
                      detection_timeout_s='0.4', **{'pose_timeout_s': '0.4', **arguments})
        cls.tf, cls.tf_static = cls.publisher('/tf', TFMessage), cls.publisher('/tf_static', TFMessage, latch=True)
        cls.camera_info = cls.publisher('/camera_info', CameraInfo)
        cls.detections = cls.publisher('/detector', cls.detector_type)
        cls.tf_static.publish(TFMessage([cls.transform('/base_link', '/lens', 0.0, 0.0)]))

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

    def see(self, time_s, with_detections=True, boxes=((100, 100, 200, 200),), focal_length=500.0,
            detector_clock_s=0.0):
        info = CameraInfo(width=640, height=480, distortion_model='plumb_bob', D=[0.0] * 5)
        info.header.frame_id = '/lens'
        info.header.stamp = rospy.Time.from_sec(START_S + time_s)
        info.K = [focal_length, 0.0, 320.0, 0.0, focal_length, 240.0, 0.0, 0.0, 1.0]
        self.camera_info.publish(info)
        if not with_detections:
            return
        self.detections.publish(self.detected(info.header.stamp + rospy.Duration(detector_clock_s), boxes))

    def detected(self, stamp, boxes):
        """What the detector says of the image with this stamp."""
        message = DetectionArray()
        message.header.stamp = stamp
        for x1, y1, x2, y2 in boxes:
            detection = Detection(class_id=CUP, score=0.9)
            detection.box.x1, detection.box.y1, detection.box.x2, detection.box.y2 = x1, y1, x2, y2
            message.detections.append(detection)
        return message

    def call(self, service):
        name = '/%s/pose_frontend/%s' % (PACKAGE, service)
        self.assertTrue(rospy.ServiceProxy(name, Trigger)().success)


class TfTest(DetectorTest):
    @classmethod
    def setUpClass(cls):
        cls.start()
        cls.wait_until_up()

    def test_1_poses_are_interpolated_and_detections_joined(self):
        self.move(0.0, 1.0)
        for i in range(1, 10):
            self.see(0.1 * i + 0.007)
        self.assert_status(0.907, FrameDone.STATUS_PROCESSED)
        self.assertIsNotNone(self.frames.at(0.907))
        frame = self.frames.at(0.507)
        self.assertAlmostEqual(frame.odom_from_camera.position.x, 0.507, places=7)
        self.assertEqual((frame.header.frame_id, frame.camera_frame), ('odom', 'lens'))
        self.assertEqual([f.frame_id for f in self.frames.messages[:9]], list(range(9)))
        self.assertEqual(len(self.joined.at(0.507).detections), 1)

    def test_2_bad_input_is_counted_and_left_out(self):
        bad = self.transform('odom', 'base_link', 1.01, math.nan)
        unnormalised = self.transform('odom', 'base_link', 1.015, 0.0)
        unnormalised.transform.rotation.z = 1.0
        self.tf.publish(TFMessage([bad, unnormalised]))
        self.move(1.02, 2.0)
        self.see(1.107, boxes=((100, 100, 200, 200), (200, 100, 100, 200), (math.nan, 0, 9, 9)))
        self.assert_status(1.107, FrameDone.STATUS_PROCESSED)
        self.assertEqual(len(self.joined.at(1.107).detections), 1)
        self.see(1.207, with_detections=False)
        self.assert_status(1.207, FrameDone.STATUS_PROCESSED)
        self.assertEqual(len(self.joined.at(1.207).detections), 0)
        self.see(1.207, with_detections=False)
        self.assert_counted('PoseFrontend', 'images with the stamp of the one before')
        self.see(1.107, with_detections=False)
        self.assert_counted('PoseFrontend', 'images out of order')
        self.see(1.307, with_detections=False, focal_length=0.0)
        self.assert_status(1.307, FrameDone.STATUS_FAILED)
        self.assert_counted('PoseFrontend', 'camera_info without a usable calibration')
        self.assert_counted('PoseFrontend', 'bad transforms')
        self.assert_counted('DetectionIngestion', 'frames without an answer of the detector')

    def test_3_no_pose_is_no_frame(self):
        self.move(2.0, 2.2)
        self.move(5.0, 5.4)
        self.see(2.607, with_detections=False)
        self.assert_status(2.607, FrameDone.STATUS_NO_POSE)
        self.see(5.107)
        self.assert_status(5.107, FrameDone.STATUS_PROCESSED)
        self.assertTrue(self.frames.at(5.107).is_break, 'the gap of some seconds')
        self.see(9.007, with_detections=False)
        self.assert_status(9.007, FrameDone.STATUS_NO_POSE)
        self.assert_counted('PoseFrontend', 'images without a pose', 2)
        session = self.control.messages[-1].session_id
        self.move(5.42, 6.0)
        self.see(5.507)
        self.assert_status(5.507, FrameDone.STATUS_PROCESSED)
        self.assertEqual(self.done.at(5.507).session_id, session, 'that one was far ahead; time did not jump back')

    def test_4_a_jump_back_in_time_begins_a_session(self):
        before = self.control.messages[-1].session_id
        self.move(0.0, 1.0)
        self.see(0.307)
        self.assertTrue(wait_until(lambda: self.control.messages[-1].session_id == before + 1, 10))
        self.assertEqual(self.control.messages[-1].command, SessionControl.COMMAND_START)
        self.assertTrue(wait_until(lambda: self.frames.messages[-1].session_id == before + 1, 10))
        self.assertEqual(self.frames.messages[-1].frame_id, 0)

    def test_5_pause_resume_reset(self):
        before = self.control.messages[-1].session_id
        self.move(1.0, 2.0)
        self.call('pause')
        self.see(1.357)
        self.assert_status(1.357, FrameDone.STATUS_FAILED)
        self.assertTrue(wait_until(lambda: self.control.messages[-1].command == SessionControl.COMMAND_PAUSE, 10))
        self.call('resume')
        self.see(1.407)
        self.assert_status(1.407, FrameDone.STATUS_PROCESSED)
        self.assertEqual(self.done.at(1.407).session_id, before)
        self.call('reset')
        self.see(1.507)
        self.assertIsNotNone(self.frames.at(1.507))
        self.assertEqual(self.frames.at(1.507).session_id, before + 1)
        self.assertEqual(self.frames.at(1.507).frame_id, 0)

    def test_6_frames_and_detections_that_do_not_meet_are_reported(self):
        self.move(2.0, 13.0)

        def summary():
            return self.diagnostics.summaries.get('DetectionIngestion', '')

        def see_until(begin_s, text, **how):
            deadline, i = time.monotonic() + 30.0, 0
            while text not in summary() and time.monotonic() < deadline:
                self.see(begin_s + 0.1 * i, **how)
                i += 1
                time.sleep(0.1)
            self.assertIn(text, summary())

        alone = "frames on '/%s/frames', but no detections on '/detector'" % PACKAGE
        see_until(2.057, alone, with_detections=False)
        self.assertIn('; gap ', summary())
        self.assert_counted('DetectionIngestion', 'times that frames and detections did not meet')
        self.see(7.357)
        self.assertTrue(wait_until(lambda: alone not in summary(), 5), summary())
        see_until(7.457, 'but none with the stamp of the other; ', detector_clock_s=0.012)
        # In between the last frame and the last detections are of two images.
        self.assertTrue(wait_until(lambda: '; gap 0.012' in summary(), 5), summary())
        self.assert_counted('DetectionIngestion', 'detections without a frame', 5)

    def test_7_no_images_and_images_without_frames_are_reported(self):
        def summary():
            return self.diagnostics.summaries.get('PoseFrontend', '')

        self.assertTrue(wait_until(lambda: "no image for 5 s: nothing on '/camera_info'" in summary(), 10), summary())
        self.move(13.0, 14.0)
        deadline, i = time.monotonic() + 10.0, 0
        while 'no frame' not in summary() and time.monotonic() < deadline:
            self.see(20.057 + 0.1 * i, with_detections=False)
            i += 1
            time.sleep(0.1)
        self.assertIn('images, but no frame for 5 s: images without a pose: tf odom -> base_link', summary())
        self.call('pause')
        self.assertTrue(wait_until(lambda: summary() == 'working', 4), summary())
        self.call('resume')
        self.move(40.0, 41.0)
        self.see(40.307, with_detections=False)
        self.assertIsNotNone(self.frames.at(40.307))
        self.assertTrue(wait_until(lambda: summary() == 'working', 4), summary())

    def test_8_a_camera_that_goes_on_after_the_end_begins_a_session(self):
        before = self.control.messages[-1].session_id
        end = self.publisher('/%s/end_of_stream' % PACKAGE, Empty)
        self.assertTrue(wait_until(lambda: end.get_num_connections() > 0, 10))
        end.publish()
        self.assertTrue(wait_until(lambda: self.frames.messages[-1].is_end, 10))
        self.move(41.0, 44.0)
        self.see(40.607, with_detections=False)
        self.assert_status(40.607, FrameDone.STATUS_FAILED)
        self.assertEqual(self.control.messages[-1].session_id, before)
        times = iter(43.007 + 0.02 * i for i in range(48))  # left out until the end is through

        def begins():
            self.see(next(times), with_detections=False)
            return wait_until(lambda: self.frames.messages[-1].session_id == before + 1, 0.5)

        self.assertTrue(wait_until(begins, 20))
        self.assertEqual([m.frame_id for m in self.frames.messages if m.session_id == before + 1], [0])

    def test_9_images_between_the_poses_of_a_slower_odometry_are_no_frames(self):
        # Sent every 20 ms, and new every 0.2 s.
        self.tf.publish(TFMessage([self.transform('odom', 'base_link', 50.0 + 0.02 * i, 0.1 * (i // 10)) for i in range(80)]))
        for i in range(24):
            self.see(50.013 + 0.05 * i, with_detections=False)
        self.assert_status(51.013, FrameDone.STATUS_PROCESSED)
        for i in range(21, 24):
            self.assert_status(50.013 + 0.05 * i, FrameDone.STATUS_NO_POSE)
        self.assert_counted('PoseFrontend', 'images between the poses of a slower odometry', 12)


class OdometryTest(DetectorTest):
    """nav_msgs/Odometry, frames made by the stamps of a detector, which is darknet_ros, and a cloud with each image."""
    detector_type = BoundingBoxes

    def detected(self, stamp, boxes):
        message = BoundingBoxes()
        message.header.stamp = stamp + rospy.Duration(0.05)
        message.image_header.stamp = stamp
        message.bounding_boxes = [BoundingBox(0.9, *box, 0, name) for box in boxes for name in ('cup', 'jug')]
        return message

    @classmethod
    def setUpClass(cls):
        camera = os.path.join(rospkg.RosPack().get_path(PACKAGE), 'config/camera/tum_fr3.yaml')
        cls.start(pose_source='odometry', trigger='detections', use_points='true', camera=camera,
                  pose_timeout_s='60')
        cls.odometry, cls.cloud = cls.publisher('/odometry', Odometry), cls.publisher('/cloud', PointCloud2)
        cls.wait_until_up()

    def drive(self, begin_s, end_s, frame_id='/odom'):
        """1 m/s along x at 50 Hz, with a tenth of a m/s and rad/s of noise."""
        for i in range(round(50 * begin_s), round(50 * end_s) + 1):
            message = Odometry()
            message.header.frame_id = frame_id
            message.header.stamp = rospy.Time.from_sec(START_S + i / 50.0)
            message.child_frame_id = '/base_link'
            message.pose.pose.position.x = i / 50.0
            message.pose.pose.orientation.w = 1.0
            for k in range(6):
                message.twist.covariance[7 * k] = 0.01
            self.odometry.publish(message)

    def show_points(self, time_s, frame_id='/lens'):
        points = [(0.0, 0.0, 1.0), (0.1, 0.2, 2.0), (float('nan'), 0.0, 1.0)]
        message = PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points), is_dense=False)
        message.header.frame_id = frame_id
        message.header.stamp = rospy.Time.from_sec(START_S + time_s)
        message.fields = [PointField(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate('xyz')]
        message.data = b''.join(struct.pack('<fff', *point) for point in points)
        self.cloud.publish(message)

    def test_poses_covariance_and_points_reach_the_frame(self):
        self.tf_static.publish(TFMessage([self.transform('base_link', 'lens', 0.0, 0.5)]))
        self.drive(0.0, 1.0)
        for time_s in (0.107, 0.207, 0.307):
            self.show_points(time_s)
            self.see(time_s)
            self.assert_status(time_s, FrameDone.STATUS_PROCESSED)
        frame = self.frames.at(0.307)
        self.assertAlmostEqual(frame.odom_from_camera.position.x, 0.807, places=6)
        self.assertTrue(frame.has_covariance)
        self.assertAlmostEqual(frame.covariance[0], 0.01 * 0.1 ** 2, places=7)
        self.assertTrue(frame.has_points)
        self.assertEqual((frame.points.width, frame.points.header.frame_id), (2, 'lens'))
        self.assertEqual(frame.camera.K[0], 535.4, "the file's, not camera_info's")
        joined = self.joined.at(0.307).detections
        self.assertEqual([(d.class_id, d.box.x2) for d in joined], [(CUP, 200.0)])
        self.assert_counted('DetectionIngestion', 'unknown class id', 3)

    def test_where_odometry_has_another_frame_is_told(self):
        def summary():
            return self.diagnostics.summaries.get('PoseFrontend', '')

        self.drive(3.0, 3.5, '/wheels')
        expected = "odometry in frame 'wheels', but odom_frame = 'odom'"
        self.assertTrue(wait_until(lambda: expected in summary(), 5), summary())
        self.drive(3.5, 4.0)
        self.assertTrue(wait_until(lambda: expected not in summary(), 5), summary())

    def test_unusable_points_are_counted(self):
        self.drive(1.0, 2.0)
        self.show_points(1.107, '/somewhere_else')
        self.see(1.107)
        self.assert_status(1.107, FrameDone.STATUS_PROCESSED)
        self.assertFalse(self.frames.at(1.107).has_points)
        self.assert_counted('PoseFrontend', 'unusable points')
        self.see(1.207)
        self.show_points(1.307)
        self.see(1.307)
        self.assert_status(1.207, FrameDone.STATUS_PROCESSED)
        self.assertFalse(self.frames.at(1.207).has_points, 'a later cloud is there')
        self.assertTrue(self.frames.at(1.307).has_points)
        self.assert_counted('PoseFrontend', 'images without points')


class RgbdTest(LiveTest):
    """Frames, what bad images are answered with, and topics that fall silent."""

    @classmethod
    def setUpClass(cls):
        cls.start(pose_source='rgbd', color='/color', depth='/depth', camera_info='/info', use_detections='false')
        cls.color, cls.depth = cls.publisher('/color', Image), cls.publisher('/depth', Image)
        cls.info, cls.tf_static = cls.publisher('/info', CameraInfo), cls.publisher('/tf_static', TFMessage, latch=True)
        cls.time_s = 0.8 + 35 * wall.PERIOD_S
        cls.parents = {}
        cls.tf_listener = rospy.Subscriber('/tf', TFMessage, cls.take_tf)
        cls.wait_until_up()
        cls.index = 0

    @classmethod
    def tearDownClass(cls):
        super().tearDownClass()
        cls.tf_listener.unregister()

    @classmethod
    def take_tf(cls, message):
        for transform in message.transforms:
            cls.parents[transform.child_frame_id] = transform.header.frame_id

    def see(self, time_s, focal=wall.FOCAL, depth=None, with_depth=True):
        stamp = rospy.Time.from_sec(START_S + time_s)
        info = wall.camera_info(stamp, focal)
        info.header.frame_id = ''  # the images alone name the camera
        self.info.publish(info)
        self.color.publish(wall.color(stamp, self.index))
        type(self).index += 1
        if with_depth:
            late = rospy.Time.from_sec(START_S + time_s + DEPTH_DELAY_S)
            self.depth.publish(depth(late) if depth else wall.depth(late))
        time.sleep(wall.PERIOD_S)

    def test_1_no_calibration(self):
        # All zero, as drivers without a calibration send it; the pair is known once the next image has come.
        for i in range(3):
            self.see(0.1 * i, focal=0.0)
        self.assert_status(0.0, FrameDone.STATUS_FAILED)
        self.assert_counted('RgbdFrontend', 'images without a calibration')
        self.assert_counted('RgbdFrontend', 'camera_info without a usable calibration')

    def test_2_frames_and_tf(self):
        for i in range(35):  # for a second the camera's place on a robot is waited for
            self.see(0.8 + wall.PERIOD_S * i)
        self.assert_status(0.8, FrameDone.STATUS_PROCESSED)
        first, last = self.frames.at(0.8), self.frames.at(0.8 + wall.PERIOD_S * 10)
        self.assertIsNotNone(last)
        moved = last.odom_from_camera.position.x - first.odom_from_camera.position.x
        self.assertAlmostEqual(moved, 10 * wall.STEP_M, delta=0.02)
        self.assertTrue(wait_until(lambda: self.parents.get(wall.FRAME[1:]) == 'odom', 10), self.parents)
        self.assertEqual(self.parents.get('odom'), 'map')
        # The robot's description comes late.
        mount = TransformStamped()
        mount.header.frame_id, mount.child_frame_id = 'base_link', wall.FRAME[1:]
        mount.header.stamp = rospy.Time.from_sec(START_S + 100.0)
        mount.transform.rotation.w = 1.0
        self.tf_static.publish(TFMessage([mount]))
        self.assertTrue(wait_until(lambda: self.sees_base(), 10), self.parents)

    def test_3_another_odometry_in_tf_is_told(self):
        other = TransformStamped()
        other.header.frame_id, other.child_frame_id = 'odom', 'base_link'
        other.header.stamp = rospy.Time.from_sec(START_S + 1.0)
        other.transform.rotation.w = 1.0
        self.assertEqual(self.diagnostics.count('RgbdFrontend', 'transforms of another odometry'), 0)
        self.publisher('/tf', TFMessage, latch=True).publish(TFMessage([other]))
        self.assert_counted('RgbdFrontend', 'transforms of another odometry')

    def sees_base(self):
        type(self).time_s += wall.PERIOD_S
        self.see(self.time_s)
        return self.parents.get('base_link') == 'odom'

    def test_3_bad_images(self):
        self.see(2.9, with_depth=False)
        self.see(2.9 + wall.PERIOD_S)
        self.see(2.9 + 2 * wall.PERIOD_S, depth=lambda stamp: wall.depth(stamp, width=100, height=100))
        self.see(2.9 + 3 * wall.PERIOD_S)
        self.see(2.9 + 4 * wall.PERIOD_S)
        self.assert_status(2.9, FrameDone.STATUS_FAILED)
        self.assert_status(2.9 + 2 * wall.PERIOD_S, FrameDone.STATUS_FAILED)
        self.assert_status(2.9 + 3 * wall.PERIOD_S, FrameDone.STATUS_PROCESSED)
        self.assert_counted('RgbdFrontend', 'colour images without depth')
        self.assert_counted('RgbdFrontend', 'unusable images')

    def test_4_a_jump_back_is_a_new_session(self):
        before = self.control.messages[-1].session_id
        for i in range(4):
            self.see(0.5 + wall.PERIOD_S * i)
        self.assert_status(0.5, FrameDone.STATUS_PROCESSED)
        self.assertEqual(self.control.messages[-1].session_id, before + 1)
        self.assertEqual(self.frames.at(0.5).frame_id, 0)

    def test_5_silence_is_reported(self):
        begin = time.monotonic()
        i = 0
        while '/depth' not in self.diagnostics.summaries.get('RgbdFrontend', '') and time.monotonic() - begin < 30.0:
            self.see(3.0 + wall.PERIOD_S * i, with_depth=False)
            i += 1
        summary = self.diagnostics.summaries.get('RgbdFrontend', '')
        self.assertIn("no images on '/depth'", summary)
        self.assertIn('gap between the last stamps', summary)
        self.assertIn("'/color': last image", summary)
        for i in range(4):
            self.see(13.0 + wall.PERIOD_S * i)
        self.assertTrue(wait_until(lambda: self.diagnostics.summaries.get('RgbdFrontend') == 'working', 4),
                        self.diagnostics.summaries)

    def test_6_depth_out_of_reach_is_reported(self):
        # In millimetres, as floats, which are metres.
        for i in range(45):
            self.see(14.0 + wall.PERIOD_S * i, depth=lambda stamp: wall.depth(stamp, value=1000.0 * wall.DISTANCE_M))
        summaries = self.diagnostics.summaries
        self.assertTrue(wait_until(lambda: 'depth.max_m = 8 m' in summaries.get('RgbdFrontend', ''), 5), summaries)
        self.assertIn('32FC1', summaries['RgbdFrontend'])


class ClockTest(LiveTest):
    """What a playback left on the master."""

    @classmethod
    def setUpClass(cls):
        rospy.set_param('/use_sim_time', True)
        cls.start(camera_info='/info')

    @classmethod
    def tearDownClass(cls):
        super().tearDownClass()
        rospy.delete_param('/use_sim_time')

    def test_a_time_that_nobody_tells_is_missed(self):
        def summary():
            return self.diagnostics.summaries.get('PoseFrontend', '')

        expected = 'use_sim_time is true, but no time has come on /clock'
        self.assertTrue(wait_until(lambda: expected in summary(), 40), self.launch.output())
        clock = self.publisher('/clock', Clock)
        self.assertTrue(wait_until(lambda: clock.publish(Clock(rospy.Time(START_S))) or expected not in summary(), 10), summary())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'live', 'live_test')
