#!/usr/bin/env python3
"""Bags in the TUM layout through tum.launch and through offline: poses from the motion capture, from a file, and found
from the images."""
import json
import os
import re
import shutil
import subprocess
import unittest

import rosbag
import rospkg
import rospy
import rostest
import yaml
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

import wall
from playback import PACKAGE, DirectoryTest, Launch, Listener, differing_files, run_program

MODEL = os.path.join(os.environ.get('SEMANTIC_TOPO_LOOP_DATA', ''), 'models', 'yolox_nano.onnx')
DEPTH_DELAY_S = 0.008
FRAMES = 25


def setUpModule():
    rospy.init_node('bag_test')


def read_poses(path):
    with open(path) as file:
        rows = [line.split() for line in file if line.strip() and not line.startswith('#')]
    return {row[0]: [float(value) for value in row[1:4]] for row in rows}


def play_and_listen(test, **arguments):
    """Plays a bag to its end while tf is listened to: the launch, and the edges of tf, each with its stamp."""
    listener, edges = Listener(), set()
    listener.subscribe('/tf', TFMessage, lambda message: edges.update(
        (t.header.frame_id, t.child_frame_id, t.header.stamp) for t in message.transforms), queue_size=10000)
    launch = Launch('tum.launch', wait_for='Listener', **arguments)
    try:
        test.assertTrue(listener.let_begin(), launch.output())
        test.assertTrue(launch.wait(90), launch.output())
    finally:
        launch.stop()
        listener.close()
    test.assertTrue(launch.player_finished(), launch.output())
    return launch, edges


class PosesTest(DirectoryTest):
    """A simulated bag: poses from the motion capture, and from a file."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.bag = cls.path('simulated.bag')
        status, output = run_program('simulate', '--output', cls.directory, '--duration', '10', '--bag', cls.bag)
        assert status == 0, output

    def play(self, output, **arguments):
        _, stamped = play_and_listen(self, bag=self.bag, detections=self.path('detections.json'),
                                     camera=self.path('camera.yaml'), output=self.path(output), **arguments)
        edges = {(parent, child) for parent, child, _ in stamped}
        children = [child for _, child in edges]
        self.assertEqual(len(children), len(set(children)), 'nobody has two parents')
        self.assertFalse([child for child in children if child.startswith('/')], 'tf2 refuses such names')
        return edges

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

    @unittest.skipUnless(os.path.exists(MODEL), 'SEMANTIC_TOPO_LOOP_DATA is not set')
    def test_a_detector_needs_no_depth_where_poses_come_from_elsewhere(self):
        frames = len(read_poses(self.path('odometry.txt')))
        for output, arguments in {'seen_by_file': {'trajectory': self.path('odometry.txt')},
                                  'seen_by_mocap': {'poses': 'mocap'}}.items():
            launch = Launch('tum.launch', bag=self.bag, detector=MODEL, camera=self.path('camera.yaml'),
                            output=self.path(output), **arguments)
            ended = launch.wait(120)
            launch.stop()
            self.assertTrue(ended, launch.output())
            if 'cannot be read as an ONNX model' in launch.output():
                self.skipTest('OpenCV is too old')
            self.assertTrue(launch.player_finished(), launch.output())
            self.assertGreaterEqual(len(read_poses(self.path(output + '/trajectory.txt'))), frames - 10)

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

    def test_poses_of_another_recording_are_one_error(self):
        other = self.path('other.txt')
        with open(self.path('odometry.txt')) as poses, open(other, 'w') as file:
            for line in filter(lambda line: not line.startswith('#'), poses):
                stamp, pose = line.split(None, 1)
                file.write('%.6f %s' % (float(stamp) + 1000.0, pose))
        launch = Launch('tum.launch', bag=self.bag, detections=self.path('detections.json'), trajectory=other,
                        camera=self.path('camera.yaml'), output=self.path('other'))
        ended = launch.wait(90)
        launch.stop()
        self.assertTrue(ended, launch.output())
        self.assertIn('player: failed: no image has a pose', launch.output())
        self.assertIn('exit code 1', launch.output())

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


class ArgumentsTest(unittest.TestCase):
    def test_arguments_that_contradict_each_other_are_refused_before_anything_starts(self):
        both, bag = 'there are both detections:= and detector:=', '/none.bag'
        for launch_file, arguments, error in [
                ('tum.launch', {'bag': bag, 'detections': '/boxes.json'}, both),
                ('tum.launch', {'bag': bag, 'detections': 'topic'}, both),
                ('tum.launch', {'bag': bag, 'trajectory': '/poses.txt', 'poses': 'rgbd'},
                 'trajectory:= needs poses:=file'),
                ('tum.launch', {'bag': bag, 'rate': '2.0'}, 'rate:= needs realtime:=true'),
                ('demo.launch', {'images': 'false'}, 'detector:= needs images:=true'),
                ('slam.launch', {'use_detections': 'false'}, 'detector:= needs use_detections:=true')]:
            with self.subTest(launch_file, **arguments):
                launch = Launch(launch_file, detector='/model.onnx', **arguments)
                ended = launch.wait(30)
                launch.stop()
                self.assertTrue(ended, launch.output())
                self.assertEqual(launch.process.returncode, 1)
                self.assertIn("Invalid <arg> tag: '%s'" % error, launch.output())
                self.assertNotIn('started with pid', launch.output())

    def test_a_detector_in_lockstep_is_waited_for_however_long(self):
        parameter = '/%s/detection_ingestion/detection_timeout_s' % PACKAGE
        for arguments, expected in [(['detector:=/model.onnx'], 1e9),
                                    (['detector:=/model.onnx', 'realtime:=true'], 2.0),
                                    (['detections:=topic', 'detection_timeout_s:=5'], 5.0)]:
            with self.subTest(arguments):
                text = subprocess.check_output(['roslaunch', '--dump-params', PACKAGE, 'tum.launch', 'bag:=/none.bag'] +
                                               arguments, universal_newlines=True)
                self.assertEqual(yaml.safe_load(text)[parameter], expected)

    def test_rviz_is_started_where_it_is_asked_for(self):
        for arguments in (['view.launch'], ['slam.launch', 'rviz:=true'], ['tum.launch', 'bag:=/none.bag', 'rviz:=true']):
            text = subprocess.check_output(['roslaunch', '--nodes', PACKAGE, *arguments], universal_newlines=True)
            self.assertIn('/%s/rviz' % PACKAGE, text.split(), arguments)

    def test_who_needs_images_gets_them_and_who_is_in_no_tf_sends_none(self):
        def parameters(launch_file, *arguments):
            text = subprocess.check_output(['roslaunch', '--dump-params', PACKAGE, launch_file, *arguments],
                                           universal_newlines=True)
            return yaml.safe_load(text)

        played = '/%s/player/' % PACKAGE
        values = parameters('tum.launch', 'bag:=/none.bag', 'poses:=mocap', 'detections:=topic')
        self.assertEqual((values[played + 'images'], values[played + 'depth_images']), (True, False))
        for arguments, sent in [(['pose_source:=rgbd'], True), (['pose_source:=rgbd', 'publish_odom_tf:=false'], False),
                                ([], True)]:
            self.assertEqual(parameters('slam.launch', *arguments)['/%s/pose_graph/publish_tf' % PACKAGE], sent, arguments)


class Recorder:
    """Writes a bag image by image, a view's step after the other."""

    def __init__(self, path):
        self.bag = rosbag.Bag(path, 'w', compression='lz4')

    def write(self, topic, message, time_s):
        self.bag.write(topic, message, wall.stamp_at(time_s))

    def step(self, index, time_s, color=None, depth=None, with_depth=True, with_rig=True):
        stamp = wall.stamp_at(time_s)
        late = wall.stamp_at(time_s + DEPTH_DELAY_S)
        chain = TransformStamped(child_frame_id='/kinect')
        chain.header.frame_id, chain.header.stamp = '/world', stamp
        chain.transform.rotation.w = 1.0
        optical = TransformStamped(child_frame_id=wall.FRAME)
        optical.header.frame_id, optical.header.stamp = '/kinect', stamp
        optical.transform.rotation.w = 1.0
        self.write('/tf', TFMessage([chain, optical] if with_rig else [chain]), time_s)
        # The driver's defaults, which the calibration given replaces.
        self.write('/camera/rgb/camera_info', wall.camera_info(stamp, focal=525.0), time_s)
        self.write('/camera/rgb/image_color', color or wall.color(stamp, index), time_s)
        if with_depth:
            self.write('/camera/depth/image', depth or wall.depth(late), time_s + DEPTH_DELAY_S)

    def close(self):
        self.bag.close()


def read_rows(path):
    with open(path) as file:
        return [line.split() for line in file if line.strip() and not line.startswith('#')]


def record(path, images, **arguments):
    """A bag of so many steps, one a period."""
    recorder = Recorder(path)
    for i in range(images):
        recorder.step(i, wall.PERIOD_S * i, **arguments)
    recorder.close()


class ImagesTest(DirectoryTest):
    """Poses found from the bag's images."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        with open(cls.path('camera.yaml'), 'w') as file:
            file.write(wall.camera_yaml())

    def play(self, bag, output, **arguments):
        arguments.setdefault('camera', self.path('camera.yaml'))
        launch = Launch('tum.launch', bag=bag, output=self.path(output), **arguments)
        ended = launch.wait(90)
        launch.stop()
        self.assertTrue(ended, launch.output())
        return launch

    def play_and_listen(self, bag, output, **arguments):
        return play_and_listen(self, bag=bag, output=self.path(output), camera=self.path('camera.yaml'), **arguments)

    def run_offline(self, bag, output, *arguments, camera=None):
        return run_program('offline', '--bag', bag, '--camera', camera or self.path('camera.yaml'), '--output',
                           self.path(output), *arguments)

    def summary(self, output):
        with open(self.path(output + '/summary.json')) as file:
            return json.load(file)

    def test_lockstep_gives_the_offline_result(self):
        bag = self.path('whole.bag')
        record(bag, FRAMES)
        detections = []
        for i in range(FRAMES):
            stamp = wall.stamp_at(wall.PERIOD_S * i)
            left = 150 - wall.STEP_PX * i
            detections.append({'file_name': '%d.%09d.png' % (stamp.secs, stamp.nsecs),
                               'detections': [{'category_id': 75, 'detection_score': 0.9,
                                               'bbox': [left, 100, left + 60, 160]}]})
        with open(self.path('detections.json'), 'w') as file:
            json.dump(detections, file)
        launch = self.play(bag, 'lockstep', detections=self.path('detections.json'))
        self.assertTrue(launch.player_finished(), launch.output())
        self.assertIn('0 dropped', launch.output())
        status, output = self.run_offline(bag, 'offline', '--detections', self.path('detections.json'))
        self.assertEqual(status, 0, output)
        self.assertEqual(differing_files(self.path('offline'), self.path('lockstep')), [])
        rows = read_rows(self.path('lockstep/trajectory_live.txt'))
        self.assertEqual(len(rows), FRAMES)
        moved = [float(b) - float(a) for a, b in zip(rows[0][1:4], rows[-1][1:4])]
        for value, expected in zip(moved, [wall.STEP_M * (FRAMES - 1), 0.0, 0.0]):
            self.assertAlmostEqual(value, expected, delta=0.02)
        self.assertEqual(self.summary('lockstep')['associations']['joint'] > 0, True)

    def test_a_wrong_calibration_is_found_and_the_bag_played_again_from_its_start(self):
        with open(self.path('true.yaml'), 'w') as file:
            file.write(wall.camera_yaml(width=320, height=240, focal=262.5))
        with open(self.path('stated.yaml'), 'w') as file:
            file.write(wall.camera_yaml(width=320, height=240, focal=292.5))
        status, text = run_program('simulate_bag', '--output', self.path('sim'), '--camera', self.path('true.yaml'),
                                   '--layout', 'office', '--seed', '31', '--duration', '4',
                                   '--set', 'trajectory.lap_s=12')
        self.assertEqual(status, 0, text)
        bag = self.path('sim/sequence.bag')
        # One iteration a window, so that the last digit of a solve is not hidden by its convergence.
        config = self.path('one_iteration.yaml')
        with open(os.path.join(rospkg.RosPack().get_path(PACKAGE), 'config/default.yaml')) as file:
            default = file.read()
        with open(config, 'w') as file:
            file.write(re.sub('window_iterations: .*', 'window_iterations: 1', default))
        self.play(bag, 'one', camera=self.path('stated.yaml'), detections=self.path('sim/detections.json'),
                  config=config)
        status, text = self.run_offline(bag, 'one_offline', '--detections', self.path('sim/detections.json'),
                                        '--config', config, camera=self.path('stated.yaml'))
        self.assertEqual(status, 0, text)
        self.assertEqual(differing_files(self.path('one_offline'), self.path('one')), [])
        launch = self.play(bag, 'replayed', camera=self.path('stated.yaml'),
                           detections=self.path('sim/detections.json'))
        self.assertTrue(launch.player_finished(), launch.output())
        self.assertIn('self-calibration', launch.output())
        self.assertIn('with 120 of 120 images, 0 of them without a pose; 0 dropped', launch.output())
        status, text = self.run_offline(bag, 'replayed_offline', '--detections', self.path('sim/detections.json'),
                                        camera=self.path('stated.yaml'))
        self.assertEqual(status, 0, text)
        self.assertEqual(differing_files(self.path('replayed_offline'), self.path('replayed')), [])
        status, text = run_program('evaluate', 'trajectory', self.path('replayed/trajectory_live.txt'),
                                   self.path('sim/groundtruth.txt'), '--json', self.path('ate.json'))
        self.assertEqual(status, 0, text)
        with open(self.path('ate.json')) as file:
            self.assertLess(json.load(file)['ate_m']['rmse'], 0.04)
        # At a rate nobody rewinds: the new session goes on with the next image.
        launch = self.play(bag, 'at_a_rate', camera=self.path('stated.yaml'),
                           detections=self.path('sim/detections.json'), lockstep='false', rate='0.5')
        self.assertIn('self-calibration', launch.output())
        self.assertNotIn('images left out before a rewind', launch.output())
        self.assertTrue(os.path.isdir(self.path('at_a_rate~')), 'what was mapped before stays')

    def test_a_bag_whose_tf_does_not_know_the_camera(self):
        bag = self.path('no_rig.bag')
        record(bag, 45, with_rig=False)
        launch, edges = self.play_and_listen(bag, 'no_rig', base_frame='kinect')
        warnings = [line for line in launch.lines if 'nothing in tf has' in line]
        self.assertEqual(len(warnings), 1, launch.output())
        self.assertIn("'%s' below 'kinect'" % wall.FRAME[1:], warnings[0])
        parents = {parent for parent, child, _ in edges if child == wall.FRAME[1:]}
        self.assertEqual(parents, {'odom'}, 'the camera is all there is to move')

    def test_a_bag_of_another_camera_moves_the_root_of_that_cameras_tree(self):
        bag = self.path('driver.bag')
        recorder = Recorder(bag)
        mount = TransformStamped(child_frame_id=wall.FRAME[1:])
        mount.header.frame_id, mount.header.stamp = 'camera_link', wall.stamp_at(0.0)
        mount.transform.rotation.w = 1.0
        recorder.write('/tf_static', TFMessage([mount]), 0.0)
        for i in range(10):
            recorder.step(i, wall.PERIOD_S * i, with_rig=False)
        recorder.close()
        _, edges = self.play_and_listen(bag, 'driver')
        self.assertIn(('odom', 'camera_link'), {edge[:2] for edge in edges})
        self.assertNotIn(('odom', wall.FRAME[1:]), {edge[:2] for edge in edges})

    def test_bad_images_are_counted_and_the_chain_goes_on(self):
        bag = self.path('bad.bag')
        recorder = Recorder(bag)
        black = wall.color(wall.stamp_at(0), 0)
        black.data = bytes(len(black.data))
        time_s = 0.0
        stamps = []
        for i in range(40):
            time_s += wall.PERIOD_S
            stamp, late = wall.stamp_at(time_s), wall.stamp_at(time_s + DEPTH_DELAY_S)
            black.header.stamp = stamp
            # After the gap the camera is elsewhere.
            place = i if i <= 30 else i + 200
            stamps.append(stamp)
            if i == 8:
                recorder.step(i, time_s, with_depth=False)
            elif i == 12:
                recorder.step(i, time_s, depth=wall.depth(late, width=wall.WIDTH // 2, height=wall.HEIGHT // 2))
            elif i == 16:
                recorder.step(i, time_s, depth=wall.depth(late, value=float('nan')))
            elif i == 20:
                recorder.step(i, time_s, color=black)
            elif i == 24:
                back = wall.stamp_at(time_s - 0.5)
                recorder.step(i, time_s, color=wall.color(back, i))
            elif i == 27:
                ahead = wall.stamp_at(time_s + 500.0)
                recorder.step(i, time_s, color=wall.color(ahead, i), depth=wall.depth(ahead))
            else:
                recorder.step(place, time_s)
            if i == 30:
                time_s += 2.0
        recorder.close()
        launch, edges = self.play_and_listen(bag, 'bad')
        text = launch.output()
        for cause in ('colour images without depth', 'images out of order', 'images stamped after the next one',
                      'unusable images', 'images with nothing to follow'):
            self.assertEqual(text.count(cause + ':'), 1, (cause, text))
        status, output = self.run_offline(bag, 'bad_offline')
        self.assertEqual(status, 0, output)
        self.assertIn('1 colour images without depth', output)
        self.assertIn('1 images out of order', output)
        self.assertIn('1 images stamped after the next one', output)
        self.assertEqual(differing_files(self.path('bad_offline'), self.path('bad')), [])
        # What the bag says about the rig at an image that is left out is played all the same.
        told = {stamp for _, child, stamp in edges if child == wall.FRAME[1:]}
        self.assertEqual([i for i, stamp in enumerate(stamps) if stamp not in told], [])
        images = self.summary('bad')['images']
        self.assertEqual(images['total'], 37)
        self.assertEqual(images['unreadable'], 1)
        self.assertGreaterEqual(self.summary('bad')['breaks'], 1, 'the gap of two seconds')
        self.assertGreaterEqual(len(read_rows(self.path('bad/trajectory.txt'))), 33)

    def test_a_damaged_bag_is_one_error_and_keeps_what_was_mapped(self):
        bag = self.path('damaged.bag')
        record(bag, 30)
        with open(bag, 'r+b') as file:
            content = file.read()
            # In the middle of a compressed chunk's data; the index at the end stays whole.
            file.seek(content.index(b'compression=lz4', 2 * len(content) // 3) + 20000)
            file.write(b'\xff' * 4000)
        launch = self.play(bag, 'damaged')
        self.assertIn('exit code 1', launch.output())
        self.assertEqual(launch.output().count('the recording ends early'), 1, launch.output())
        status, output = self.run_offline(bag, 'damaged_offline')
        self.assertEqual(status, 1, output)
        self.assertEqual(output.count('the recording ends early'), 1, output)
        self.assertGreater(len(read_rows(self.path('damaged_offline/trajectory.txt'))), 5)
        self.assertEqual(differing_files(self.path('damaged_offline'), self.path('damaged')), [])

    def test_a_bag_without_depth_says_so(self):
        bag = self.path('color.bag')
        record(bag, 3, with_depth=False)
        status, output = self.run_offline(bag, 'color')
        self.assertEqual(status, 1, output)
        self.assertIn('holds no message on /camera/depth/image', output)


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'bag', 'bag_test')
