#!/usr/bin/env python3
"""demo.launch on its simulated odometry, from end to end: what it says on its topics, offline's files, objects in the
last correction, and a run that finds its place in the map of an earlier one."""
import csv
import glob
import json
import os
import shutil
import threading
import time

import rospkg
import rospy
import rostest
from geometry_msgs.msg import Point, TransformStamped
from nav_msgs.msg import Path
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from playback import (PACKAGE, RESULT_FILES, Diagnostics, DirectoryTest, Listener, demo, differing_files, is_closed,
                      rows_of, run_offline, run_program, wait_until)
from semantic_topo_loop.msg import FrameDone, Quadric, QuadricMap
from semantic_topo_loop.srv import (LoadMap, QueryObjects, QueryObjectsRequest, SaveMap, SaveTrajectory, WhyLoop,
                                    WhyLoopResponse)


def setUpModule():
    rospy.init_node('demo_test')


class Heard:
    """What was published on the topics that users look at."""

    def __init__(self):
        self.lock = threading.Lock()
        self.done = []
        self.edges = set()
        self.last = {}
        self.listener = Listener()
        self.listener.subscribe('/tf', TFMessage, self.take_tf)
        self.listener.subscribe('/%s/frame_done' % PACKAGE, FrameDone, self.take_done, queue_size=10000)
        for topic, kind in [('path_odometry', Path), ('path_corrected', Path), ('quadric_map', QuadricMap),
                            ('markers/quadrics', MarkerArray), ('markers/labels', MarkerArray),
                            ('markers/keyframes', MarkerArray)]:
            self.listener.subscribe('/%s/%s' % (PACKAGE, topic), kind, self.take, topic)

    def take_tf(self, message):
        with self.lock:
            self.edges |= {(t.header.frame_id, t.child_frame_id) for t in message.transforms}

    def take_done(self, message):
        with self.lock:
            self.done.append(message)

    def take(self, message, topic):
        with self.lock:
            self.last[topic] = message


class DemoTest(DirectoryTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.data, cls.results, cls.saved = cls.path('the data'), cls.path('the results'), cls.path('the map.db')
        cls.heard = Heard()
        # It stays up at the end, so that what is published at intervals can be heard.
        cls.launch = demo(duration='16', data=cls.data, output=cls.results, exit_at_end='false', save_map=cls.saved,
                          save_dir=cls.path(''), wait_for='Listener')
        assert cls.heard.listener.let_begin(), cls.launch.output()
        cls.status, cls.said = run_program('wait_for_player', '__ns:=/' + PACKAGE, timeout_s=90)

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()
        super().tearDownClass()

    def test_plays_to_the_end_and_leaves_every_file(self):
        self.assertEqual(self.status, 0, self.launch.output())
        self.assertIn('player: finished', self.said)
        self.assertEqual(sorted(os.listdir(self.results)), sorted(RESULT_FILES))

    def test_maps_objects(self):
        with open(os.path.join(self.results, 'objects.csv')) as file:
            states = [row['state'] for row in csv.DictReader(file)]
        self.assertGreaterEqual(states.count('confirmed'), 3, states)

    def test_answers_every_image_and_the_end(self):
        with open(os.path.join(self.data, 'odometry.txt')) as file:
            images = sum(1 for line in file if not line.startswith('#'))
        ids = [done.frame_id for done in self.heard.done]
        self.assertEqual(ids, list(range(images + 1)))
        statuses = [done.status for done in self.heard.done]
        self.assertEqual(set(statuses[:-1]), {FrameDone.STATUS_PROCESSED})
        self.assertEqual(statuses[-1], FrameDone.STATUS_END)

    def test_publishes_what_rviz_shows(self):
        topics = {'path_odometry', 'path_corrected', 'quadric_map', 'markers/quadrics', 'markers/labels',
                  'markers/keyframes'}
        self.assertTrue(wait_until(lambda: topics <= set(self.heard.last), 10), set(self.heard.last))
        self.assertIn(('map', 'odom'), self.heard.edges)
        self.assertIn(('odom', 'camera_optical_frame'), self.heard.edges)
        self.assertGreater(len(self.heard.last['path_corrected'].poses), 10)
        self.assertGreater(len(self.heard.last['markers/quadrics'].markers), 3)

    def test_explains_pairs_of_keyframes(self):
        why_loop = rospy.ServiceProxy('/%s/loop_detection/why_loop' % PACKAGE, WhyLoop)
        with open(os.path.join(self.results, 'keyframes.csv')) as file:
            last = max(int(row['keyframe_id']) for row in csv.DictReader(file))
        answer = why_loop(last + 1, 0)
        self.assertEqual((answer.status, answer.has_closure), (WhyLoopResponse.STATUS_UNKNOWN_KEYFRAME, False))
        self.assertIn('keyframe %d is unknown: there are 0 to %d' % (last + 1, last), answer.explanation)
        self.assertEqual(why_loop(1, 2).status, WhyLoopResponse.STATUS_WRONG_ORDER)
        # All within loop.min_gap_s, so that the pair is compared for the answer.
        answers = [why_loop(last // 2 + k, k) for k in range(last // 2)]
        too_recent = [a for a in answers if a.status == WhyLoopResponse.STATUS_TOO_RECENT and a.has_closure]
        self.assertTrue(too_recent, [a.explanation for a in answers])
        self.assertIn('compared now', too_recent[0].explanation)
        self.assertGreaterEqual(too_recent[0].closure.inliers, 4)

    def test_lockstep_is_offline_byte_for_byte(self):
        offline, saved = self.path('offline'), self.path('offline.db')
        run_offline(self, self.data, offline, '--save-map', saved)
        self.assertEqual(differing_files(offline, self.results), [])
        self.assertTrue(wait_until(lambda: is_closed(self.saved), 10), self.launch.output())
        self.assertTrue(rows_of(self, saved) == rows_of(self, self.saved))

    def test_objects_are_asked_for(self):
        query = rospy.ServiceProxy('/%s/quadric_mapping/query_objects' % PACKAGE, QueryObjects)
        everything = query(QueryObjectsRequest())
        with open(os.path.join(self.results, 'objects.csv')) as file:
            rows = list(csv.DictReader(file))
        self.assertEqual([o.id for o in everything.objects if o.has_ellipsoid], [int(row['id']) for row in rows])
        confirmed = query(QueryObjectsRequest(states=[Quadric.STATE_CONFIRMED]))
        self.assertEqual(len(confirmed.objects), sum(row['state'] == 'confirmed' for row in rows))
        label = confirmed.labels[0]
        same = query(QueryObjectsRequest(labels=[label]))
        self.assertTrue(same.objects and set(same.labels) == {label})
        at = confirmed.objects[0].map_from_quadric.position
        near = query(QueryObjectsRequest(low=Point(at.x - 0.01, at.y - 0.01, at.z - 0.01),
                                         high=Point(at.x + 0.01, at.y + 0.01, at.z + 0.01)))
        self.assertEqual([o.id for o in near.objects], [confirmed.objects[0].id])
        self.assertEqual(len(query(QueryObjectsRequest(since=rospy.Time(1500000000))).objects), 0)
        for wrong, message in ((QueryObjectsRequest(labels=['nothing']), "label 'nothing'"),
                               (QueryObjectsRequest(states=[7]), 'states: 7 is no state'),
                               (QueryObjectsRequest(low=Point(1.0, 0.0, 0.0)), 'low must not be above high'),
                               (QueryObjectsRequest(high=Point(0.0, float('nan'), 0.0)), 'low must not be above high')):
            answer = query(wrong)
            self.assertIn(message, answer.message)
            self.assertEqual(len(answer.objects), 0)

    def test_the_trajectory_is_saved_where_it_may(self):
        save = rospy.ServiceProxy('/%s/pose_graph/save_trajectory' % PACKAGE, SaveTrajectory)
        path = self.path('keyframes.txt')
        answer = save('keyframes.txt')
        self.assertTrue(answer.success, answer.message)
        with open(path) as saved:
            poses = [line for line in saved if not line.startswith('#')]
        with open(os.path.join(self.results, 'keyframes.csv')) as table:
            self.assertEqual(len(poses), len(table.readlines()) - 1)
        none = save('no_folder/keyframes.txt')
        self.assertIn('No such file', none.message)
        refused = save('/tmp/elsewhere.txt')
        self.assertFalse(refused.success)
        self.assertIn('is not below', refused.message)


class GraphObjectsTest(DirectoryTest):
    """A run whose loops show that its odometry drifts, so that objects take part in the last correction."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.diagnostics = Diagnostics()
        # Into the second lap, in which loops are closed.
        cls.launch = demo(duration='32', data=cls.path('data'), output=cls.path('lockstep'),
                          save_map=cls.path('lockstep.db'), exit_at_end='false')
        cls.status, _ = run_program('wait_for_player', '__ns:=/' + PACKAGE, timeout_s=100)

    @classmethod
    def tearDownClass(cls):
        cls.launch.stop()
        super().tearDownClass()

    def test_diagnostics_count_loops_as_the_summary_does(self):
        with open(self.path('lockstep/summary.json')) as file:
            reasons = json.load(file)['loops']['reasons']
        self.assertGreater(len(reasons), 1)
        expected = {'loops accepted' if reason == 'accepted' else 'loops rejected: ' + reason: count
                    for reason, count in reasons.items()}

        def counted():
            return {name: self.diagnostics.count('LoopDetection', name) for name in expected}

        wait_until(lambda: counted() == expected, 10)
        self.assertEqual(counted(), expected)

    def test_diagnostics_tell_objects_and_the_last_optimisation(self):
        with open(self.path('lockstep/summary.json')) as file:
            summary = json.load(file)
        self.assertGreater(summary['landmarks']['confirmed'], 3)
        expected = {state: summary['landmarks'].get(state, 0) for state in ('candidate', 'confirmed', 'retired')}

        def counted():
            return {state: self.diagnostics.count('QuadricMapping', 'objects ' + state) for state in expected}

        wait_until(lambda: counted() == expected, 10)
        self.assertEqual(counted(), expected)
        unit = summary['unit']
        self.assertEqual(self.diagnostics.values['QuadricMapping', 'unit of length by sizes'],
                         '%.2f m, 1 sigma %.0f %%' % (unit['metres'], 100 * unit['sigma']))
        with open(self.path('lockstep/loop_verdicts.csv')) as file:
            rejected = sum(row['kept'] == '0' for row in csv.DictReader(file))
        text = ' keyframes moved, %d loops kept, %d rejected' % (summary['loops']['kept'], rejected)

        def last():
            return self.diagnostics.values.get(('PoseGraph', 'last optimisation'), '')

        self.assertTrue(wait_until(lambda: text in last(), 10), last())
        self.assertRegex(last(), r'^stamp \d+\.\d+, \d+\.\d\d ms, \d+ ')
        memory = self.diagnostics.values['PoseGraph', 'memory of the process']
        self.assertRegex(memory, r'^\d+ MiB$')
        self.assertGreater(int(memory.split()[0]), 10)

    def test_a_front_end_that_is_played_to_warns_neither_before_nor_after(self):
        time.sleep(8)  # longer than its patience
        self.assertEqual([text for stage, text in self.diagnostics.complaints if stage == 'PoseFrontend'], [])

    def test_lockstep_is_offline_byte_for_byte(self):
        self.assertEqual(self.status, 0, self.launch.output())
        self.assertTrue(wait_until(lambda: is_closed(self.path('lockstep.db')), 10), self.launch.output())
        run_offline(self, self.path('data'), self.path('offline'), '--save-map', self.path('offline.db'))
        self.assertEqual(differing_files(self.path('offline'), self.path('lockstep')), [])
        self.assertTrue(rows_of(self, self.path('offline.db')) == rows_of(self, self.path('lockstep.db')), 'corrected')
        with open(self.path('lockstep/summary.json')) as file:
            self.assertGreater(json.load(file)['loops']['kept'], 5)
        run_offline(self, self.path('data'), self.path('without'), '--set', 'pose_graph.objects=off')
        differing = [name for name, _ in differing_files(self.path('without'), self.path('lockstep'))]
        self.assertIn('trajectory.txt', differing, 'the objects took part')
        self.assertIn('trajectory_live.txt', differing, 'while the robot ran, too')


class SwitchTest(DirectoryTest):
    def test_no_loop_is_closed_while_loop_closing_is_off(self):
        listener = Listener()
        launch = demo(duration='32', data=self.path('data'), output=self.path('off'), wait_for='Listener')
        try:
            switch = '/%s/loop_detection/set_loop_closing' % PACKAGE
            rospy.wait_for_service(switch, 60)
            self.assertTrue(rospy.ServiceProxy(switch, SetBool)(False).success)
            self.assertTrue(listener.let_begin(), launch.output())
            self.assertTrue(launch.wait(100) and launch.player_finished(), launch.output())
        finally:
            launch.stop()
        with open(self.path('off/loops.csv')) as file:
            self.assertEqual([row for row in csv.DictReader(file) if row['accepted'] != '0'], [])
        # The same room with it on.
        run_offline(self, self.path('data'), self.path('on'))
        with open(self.path('on/loops.csv')) as file:
            self.assertGreater(sum(row['accepted'] == '1' for row in csv.DictReader(file)), 5)


class EarlierMapTest(DirectoryTest):
    """A run's map, and later runs that find their place in it and go on with it."""

    def play(self, name, **arguments):
        """Plays the room to its end; the nodes stay up."""
        launch = demo(duration='20', data=self.path(name), output=self.path(name + '/results'), exit_at_end='false',
                      **arguments)
        try:
            status, _ = run_program('wait_for_player', '__ns:=/' + PACKAGE, timeout_s=90)
            self.assertEqual(status, 0, launch.output())
        except BaseException:
            launch.stop()
            raise
        return launch

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.map = cls.path('map.db')
        cls.home = os.path.realpath(rospkg.get_ros_home())

    def test_1_a_run_saves_its_map(self):
        # A relative path is one below the nodes' working directory.
        launch = self.play('first', save_map=os.path.relpath(self.map, self.home))
        copy = os.path.join(self.home, 'semantic_topo_loop_test_%d_copy.db' % os.getpid())
        try:
            self.assertTrue(wait_until(lambda: is_closed(self.map), 10), launch.output())
            save = rospy.ServiceProxy('/%s/map_database/save_map' % PACKAGE, SaveMap)
            answer = save(os.path.basename(copy))
            self.assertTrue(answer.success, answer.message)
            self.assertEqual(os.path.realpath(answer.message), copy)
            self.assertEqual(rows_of(self, copy), rows_of(self, self.map))
            self.assertEqual(answer.sessions, 1)
            self.assertGreater(min(answer.keyframes, answer.objects, answer.submaps), 1)
            refused = save('/tmp/elsewhere.db')
            self.assertFalse(refused.success)
            self.assertIn('is not below', refused.message)
        finally:
            launch.stop()
            if os.path.exists(copy):
                os.remove(copy)

    def test_2_a_later_run_finds_its_place(self):
        launch = self.play('second', map=self.map, frozen='true')
        try:
            transform = rospy.wait_for_message('/%s/earlier_map_from_odom' % PACKAGE, TransformStamped, 10)
            answer = rospy.ServiceProxy('/%s/map_database/save_map' % PACKAGE, SaveMap)('any.db')
        finally:
            launch.stop()
        # The same odometry twice: both runs begin at the origin of their maps.
        translation = transform.transform.translation
        self.assertLess(max(abs(translation.x), abs(translation.y), abs(translation.z)), 0.15, transform)
        self.assertGreater(abs(transform.transform.rotation.w), 0.999, transform)
        self.assertEqual((transform.header.frame_id, transform.child_frame_id), ('earlier_map', 'odom'))
        results = self.path('second/results')
        self.assertTrue(wait_until(lambda: os.path.exists(os.path.join(results, 'relocalisations.csv')), 10))
        with open(os.path.join(results, 'summary.json')) as file:
            self.assertGreaterEqual(json.load(file)['relocalisation']['agreeing'], 3)
        self.assertFalse(answer.success)
        self.assertIn("parameter 'save_map_file' is empty", answer.message)

    def test_3_a_later_run_goes_on_with_it_as_offline_does(self):
        both = self.path('both.db')
        shutil.copy(self.map, both)
        launch = self.play('third', map=both, save_map=both)
        try:
            self.assertTrue(wait_until(lambda: is_closed(both), 10), launch.output())
        finally:
            launch.stop()
        self.assertTrue(any('joined the map of earlier sessions' in line for line in launch.lines), launch.output())
        offline = self.path('offline')
        run_offline(self, self.path('third'), offline, '--map', self.map, '--save-map', self.path('offline.db'))
        self.assertEqual(differing_files(offline, self.path('third/results')), [])
        self.assertTrue(rows_of(self, both) == rows_of(self, self.path('offline.db')))
        self.assertEqual(glob.glob(both + '.loaded*'), [], 'what the session read')
        with open(os.path.join(offline, 'summary.json')) as file:
            self.assertGreaterEqual(json.load(file)['joined_map']['loops'], 1)

    def test_4_a_map_is_loaded_while_the_robot_runs(self):
        there = os.path.join(self.home, 'semantic_topo_loop_test_%d_map.db' % os.getpid())
        shutil.copy(self.map, there)
        launch = demo(duration='20', data=self.path('fourth'), lockstep='false', exit_at_end='false', rate='2',
                      save_map=self.path('fourth.db'))
        try:
            load = '/%s/pose_frontend/load_map' % PACKAGE
            rospy.wait_for_service(load, 60)
            self.assertIn('is not below', rospy.ServiceProxy(load, LoadMap)('/tmp/elsewhere.db', False).message)
            self.assertIn('cannot open the file', rospy.ServiceProxy(load, LoadMap)('none.db', False).message)
            self.assertTrue(wait_until(lambda: os.path.exists(self.path('fourth.db')), 30), launch.output())
            answer = rospy.ServiceProxy(load, LoadMap)(os.path.basename(there), False)
            self.assertTrue(answer.success, answer.message)
            # Before that session has written anything.
            self.assertTrue(rospy.ServiceProxy('/%s/pose_frontend/reset' % PACKAGE, Trigger)().success)
            fixed = '/%s/pose_frontend/set_localization_mode' % PACKAGE
            self.assertTrue(rospy.ServiceProxy(fixed, SetBool)(True).success)
            query = rospy.ServiceProxy('/%s/quadric_mapping/query_objects' % PACKAGE, QueryObjects)
            self.assertTrue(wait_until(lambda: len(query(QueryObjectsRequest()).objects) > 5, 10))
            known = {o.id for o in query(QueryObjectsRequest()).objects}
            run_program('wait_for_player', '__ns:=/' + PACKAGE, timeout_s=60)
            self.assertLessEqual({o.id for o in query(QueryObjectsRequest()).objects}, known, 'the map is fixed')
            self.assertTrue(is_closed(self.path('fourth.db~')), 'what the session before it had mapped')
        finally:
            launch.stop()
            os.remove(there)
        self.assertTrue(any('joined the map of earlier sessions' in line for line in launch.lines), launch.output())

    def test_a_file_that_is_none_is_named(self):
        launch = demo(duration='4', data=self.path('none'), map=self.path('no_such_file.db'))
        try:
            self.assertTrue(wait_until(lambda: 'PoseFrontend is not working' in launch.output(), 30), launch.output())
        finally:
            launch.stop()
        self.assertTrue(any('no_such_file.db' in line and 'FATAL' in line for line in launch.lines), launch.output())


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'demo', 'demo_test')
