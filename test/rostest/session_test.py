#!/usr/bin/env python3
"""What happens to the chain in mid-stream: the session's services, a parameter that nobody knows, an unloaded stage."""
import contextlib
import os
import signal
import sqlite3
import subprocess
import threading
import time
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from std_srvs.srv import Trigger

from playback import PACKAGE, RESULT_FILES, Diagnostics, DirectoryTest, Listener, demo, wait_until
from semantic_topo_loop.msg import AssociationArray, FrameDone, QuadricMap


def setUpModule():
    rospy.init_node('session_test')


class ControlTest(DirectoryTest):
    """The session's services during playback, and a parameter that nobody knows."""

    def setUp(self):
        self.lock = threading.Lock()
        self.done = []
        self.subscriber = rospy.Subscriber('/%s/frame_done' % PACKAGE, FrameDone, self.take_done, queue_size=10000)

    def tearDown(self):
        self.subscriber.unregister()

    def take_done(self, message):
        with self.lock:
            self.done.append(message)

    def call(self, service):
        self.assertTrue(rospy.ServiceProxy('/%s/pose_frontend/%s' % (PACKAGE, service), Trigger)().success)

    def test_pause_resume_reset(self):
        results, maps = self.path('results'), []
        listener = rospy.Subscriber('/%s/quadric_map' % PACKAGE, QuadricMap, maps.append, queue_size=1000)
        launch = demo(duration='10', data=self.path('paused'), lockstep='false', output=results)
        try:
            self.assertTrue(wait_until(lambda: len(self.done) > 30, 60), launch.output())
            self.call('pause')
            time.sleep(0.5)
            paused_at = len(self.done)
            time.sleep(1.0)
            self.assertEqual(len(self.done), paused_at, 'the player waits while the session is paused')
            saved = rospy.ServiceProxy('/%s/recorder/save_results' % PACKAGE, Trigger)()
            self.assertTrue(saved.success and results in saved.message, saved.message)
            self.assertEqual(sorted(os.listdir(results)), sorted(RESULT_FILES))
            self.call('resume')
            self.assertTrue(wait_until(lambda: len(self.done) > paused_at + 30, 10))
            self.assertEqual({message.session_id for message in self.done}, {1})
            self.call('reset')
            self.assertTrue(launch.wait(40), launch.output())
        finally:
            launch.stop()
            listener.unregister()
        self.assertTrue(launch.player_finished(), launch.output())
        self.assertEqual(sorted({m.session_id for m in maps}), [1, 2])
        first = next(m for m in maps if m.session_id == 2)
        self.assertEqual((first.map_version, len(first.quadrics)), (0, 0), 'the map of a new session is empty')
        second = [message.frame_id for message in self.done if message.session_id == 2]
        self.assertEqual(second, list(range(len(second))), 'a session counts its own frames')
        with open(os.path.join(results, 'trajectory.txt')) as file:
            self.assertEqual(sum(1 for _ in file), len(second) - 1, 'the files are those of the last session')
        self.assertEqual(sorted(os.listdir(results + '~')), sorted(RESULT_FILES), 'the first one stays beside them')
        with open(os.path.join(results + '~', 'trajectory.txt')) as file:
            first = len([message for message in self.done if message.session_id == 1])
            self.assertAlmostEqual(sum(1 for _ in file), first, delta=5)
        self.assertEqual(sorted(name for name in os.listdir(self.directory) if name.startswith('results')),
                         ['results', 'results~'])

    def test_results_that_cannot_be_written_are_told_at_the_begin(self):
        with open(self.path('file'), 'w'):
            pass
        launch = demo(duration='4', data=self.path('data'), output=self.path('file/results'))
        try:
            self.assertTrue(wait_until(lambda: 'Recorder is not working' in launch.output(), 30), launch.output())
        finally:
            launch.stop()
        fatal = [line for line in launch.lines if self.path('file/results') in line and 'not working' in line]
        self.assertEqual(len(fatal), 1, launch.output())
        self.assertIn('FATAL', fatal[0])

    def test_a_starved_loader_unloads_nothing(self):
        launch = demo(duration='20', data=self.path('starved'), lockstep='false', stall_timeout_s='4')
        try:
            self.assertTrue(wait_until(lambda: len(self.done) > 150, 60), launch.output())
            node = rosgraph.Master(rospy.get_name()).lookupNode('/%s/quadric_mapping' % PACKAGE)
            loader = ServerProxy(node).getPid(rospy.get_name())[2]
            os.kill(loader, signal.SIGSTOP)
            time.sleep(6.0)  # a bond that has formed breaks after 4 s
            os.kill(loader, signal.SIGCONT)
            self.assertTrue(launch.wait(40), launch.output())
        finally:
            launch.stop()
        self.assertTrue(launch.player_finished(), launch.output())

    def test_an_unknown_parameter_is_named(self):
        config = self.path('config.yaml')
        with open(config, 'w') as file:
            file.write('loop: {no_such_key: 1}\n')
        launch = demo(duration='4', data=self.path('data'), config=config)
        error = "unknown parameter 'loop.no_such_key' = '1'"
        try:
            self.assertTrue(wait_until(lambda: error in launch.output(), 30), launch.output())
            self.assertIsNone(launch.process.poll(), 'the manager lives')
        finally:
            launch.stop()
        self.assertTrue(all('FATAL' in line for line in launch.lines if error in line))
        # Nothing of it is left for the next launch on the same master.
        launch = demo(duration='4', data=self.path('data'))
        ended = launch.wait(60)
        launch.stop()
        self.assertTrue(ended and launch.player_finished(), launch.output())


class InterruptTest(DirectoryTest):
    def test_what_was_mapped_is_saved_by_ctrl_c(self):
        results, submaps = self.path('results'), self.path('submaps.db')
        listener = Listener()
        done = []
        listener.subscribe('/%s/frame_done' % PACKAGE, FrameDone, done.append, queue_size=1000)
        launch = demo(duration='120', data=self.path('data'), lockstep='false', output=results, save_map=submaps,
                      wait_for='Listener')
        try:
            self.assertTrue(listener.let_begin(), launch.output())
            self.assertTrue(wait_until(lambda: len(done) > 150, 60), launch.output())
            answered = len(done)
        finally:
            launch.stop()
        self.assertEqual(sorted(os.listdir(results)), sorted(RESULT_FILES), launch.output())
        with open(os.path.join(results, 'trajectory.txt')) as file:
            self.assertGreaterEqual(sum(1 for _ in file), answered - 5)
        with open(os.path.join(results, 'objects.csv')) as file:
            self.assertGreater(sum(1 for _ in file), 1)
        with contextlib.closing(sqlite3.connect(submaps)) as database:
            self.assertGreaterEqual(database.execute('SELECT COUNT(*) FROM submap').fetchone()[0], 1)
        self.assertNotIn('escalating to SIGTERM', launch.output())

    def test_what_could_not_be_saved_is_saved_by_ctrl_c(self):
        results = self.path('blocked')
        listener = Listener()
        done = []
        listener.subscribe('/%s/frame_done' % PACKAGE, FrameDone, done.append, queue_size=1000)
        launch = demo(duration='120', data=self.path('data'), lockstep='false', output=results, wait_for='Listener')
        try:
            self.assertTrue(listener.let_begin(), launch.output())
            self.assertTrue(wait_until(lambda: len(done) > 30, 60), launch.output())
            self.assertTrue(rospy.ServiceProxy('/%s/pose_frontend/pause' % PACKAGE, Trigger)().success)
            time.sleep(0.5)  # all that was on its way is recorded
            os.rmdir(results)
            with open(results, 'w'):
                pass
            saved = rospy.ServiceProxy('/%s/recorder/save_results' % PACKAGE, Trigger)()
            self.assertFalse(saved.success)
            self.assertIn(results, saved.message)
            os.remove(results)
        finally:
            launch.stop()
            listener.close()
        self.assertEqual(sorted(os.listdir(results)), sorted(RESULT_FILES), launch.output())


class UnloadTest(DirectoryTest):
    """A stage that is unloaded in mid-stream: the others live on, and the player ends and names it."""

    def setUp(self):
        self.lock = threading.Lock()
        self.done = 0
        self.associations = 0
        self.diagnostics = Diagnostics()
        rospy.Subscriber('/%s/frame_done' % PACKAGE, FrameDone, self.take_done)
        rospy.Subscriber('/%s/associations' % PACKAGE, AssociationArray, self.take_associations)

    def take_done(self, _):
        with self.lock:
            self.done += 1

    def take_associations(self, _):
        with self.lock:
            self.associations += 1

    def test_unloaded_stage_is_named(self):
        launch = demo(duration='30', data=self.path('data'), lockstep='false', stall_timeout_s='4')
        try:
            self.assertTrue(wait_until(lambda: self.done > 60, 60), launch.output())
            unloaded = subprocess.run(['rosrun', 'nodelet', 'nodelet', 'unload', '/%s/quadric_mapping' % PACKAGE,
                                       '/%s/manager' % PACKAGE], stdout=subprocess.DEVNULL, timeout=20)
            self.assertEqual(unloaded.returncode, 0)
            alive = self.diagnostics.summaries
            alive.clear()
            before = self.associations
            others = {'PoseFrontend', 'DetectionIngestion', 'ObjectAssociation', 'LoopDetection', 'PoseGraph',
                      'Recorder', 'Visualization', 'Player'}
            self.assertTrue(wait_until(lambda: others <= alive.keys(), 3.5), alive)
            self.assertNotIn('QuadricMapping', alive)
            self.assertGreater(self.associations, before)
            self.assertTrue(launch.wait(40), launch.output())
        finally:
            launch.stop()
        # The stage's loader, which cannot know, may say at the end that there is nothing to unload.
        fatal = [line for line in launch.lines if 'FATAL' in line and 'Failed to unload nodelet' not in line]
        self.assertEqual(len(fatal), 1, fatal)
        self.assertIn('QuadricMapping', fatal[0])
        self.assertIn('player: stalled: QuadricMapping', launch.output())
        self.assertIn('exit code 1', launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'session', 'session_test')
