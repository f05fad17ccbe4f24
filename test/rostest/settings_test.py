#!/usr/bin/env python3
"""Live settings by dynamic_reconfigure's own client and program: what they show, change and are refused."""
import subprocess
import threading

import rospy
import rostest
from dynamic_reconfigure.client import Client
from std_srvs.srv import SetBool, Trigger

from playback import PACKAGE, Diagnostics, DirectoryTest, Listener, demo, differing_files, run_offline, wait_until
from semantic_topo_loop.msg import Association, AssociationArray

CHANGED = {'object_association': {'min_score': 0.4}, 'quadric_mapping': {'confirm_seen_s': 0.6},
           'loop_detection': {'min_inliers': 7, 'max_rms_m': 0.08},
           'pose_graph': {'interval_keyframes': 4, 'min_interval_keyframes': 2}}
MODULES = {'object_association': 'association', 'quadric_mapping': 'mapping', 'loop_detection': 'loop',
           'pose_graph': 'pose_graph'}


def setUpModule():
    rospy.init_node('settings_test')


def node(name):
    return '/%s/%s' % (PACKAGE, name)


def connect(name):
    client = Client(node(name), timeout=60)
    assert client.get_configuration(timeout=10) is not None and client.get_parameter_descriptions(timeout=10)
    return client


class BeforeTheFirstFrameTest(DirectoryTest):
    """Settings that change before the first image are what offline is given by --set; the rest stays as it was."""

    def play(self, name, changed):
        listener = Listener()
        launch = demo(duration='32', data=self.path('data'), output=self.path(name), wait_for='Listener')
        try:
            for stage, settings in changed.items():
                client = connect(stage)
                answer = client.update_configuration(dict(settings))
                client.close()
                self.assertEqual({key: answer[key] for key in settings}, settings)
            self.assertTrue(listener.let_begin(), launch.output())
            self.assertTrue(launch.wait(100) and launch.player_finished(), launch.output())
        finally:
            launch.stop()
            listener.close()

    def test_results_are_those_of_offline_byte_for_byte(self):
        self.play('changed', CHANGED)
        run_offline(self, self.path('data'), self.path('offline'), *[
            word for stage, settings in CHANGED.items() for key, value in settings.items()
            for word in ('--set', '%s.%s=%s' % (MODULES[stage], key, value))])
        self.assertEqual(differing_files(self.path('offline'), self.path('changed')), [])
        # A request that asks for nothing, and one for what holds, change nothing.
        self.play('same', {'loop_detection': {}, 'object_association': {'min_score': 0.25}})
        run_offline(self, self.path('data'), self.path('default'))
        self.assertEqual(differing_files(self.path('default'), self.path('same')), [])
        self.assertIn('loops.csv', [name for name, _ in differing_files(self.path('default'), self.path('changed'))])


class WhileRunningTest(DirectoryTest):
    def setUp(self):
        self.lock = threading.Lock()
        self.last = AssociationArray()
        self.subscriber = rospy.Subscriber('/%s/associations' % PACKAGE, AssociationArray, self.take)
        self.diagnostics = Diagnostics()

    def tearDown(self):
        self.subscriber.unregister()
        self.diagnostics.subscriber.unregister()

    def take(self, message):
        with self.lock:
            if message.associations:
                self.last = message

    def seen(self):
        """Session of the last boxes, and whether some of them reached a landmark."""
        with self.lock:
            return self.last.session_id, any(a.landmark_id >= 0 for a in self.last.associations)

    def test_settings_are_shown_changed_and_refused(self):
        launch = demo(duration='120', data=self.path('data'), lockstep='false')
        try:
            self.assertTrue(wait_until(lambda: self.seen() == (1, True), 60), launch.output())
            self.check_association(launch)
            self.check_switch()
        finally:
            launch.stop()

    def check_association(self, launch):
        association = connect('object_association')
        described = {p['name']: p for p in association.get_parameter_descriptions()}
        self.assertEqual((described['min_score']['type'], described['min_score']['min'], described['min_score']['max'],
                          described['min_score']['default']), ('double', 0.0, 1.0, 0.25))
        self.assertNotIn('mode', described)
        self.assertEqual(set(association.get_configuration()) - {'groups'}, set(described))

        # By the program, as a user would; no score is above 1.
        subprocess.check_call(['rosrun', 'dynamic_reconfigure', 'dynparam', 'set', node('object_association'),
                               'min_score', '1.0'])
        self.assertTrue(wait_until(lambda: association.get_configuration()['min_score'] == 1.0, 10))
        self.assertTrue(wait_until(lambda: self.seen() == (1, False), 10), 'the next frames are judged by it')
        with self.lock:
            self.assertEqual({a.level for a in self.last.associations} - {
                Association.LEVEL_LOW_SCORE, Association.LEVEL_IGNORED}, set())
        self.assertEqual(rospy.get_param(node('object_association/association/min_score')), 1.0)

        # One bad value refuses all that came with it, once for each request.
        for bad in ({'min_score': 1.5}, {'min_score': 0.5, 'size_tolerance': -1.0}):
            answer = association.update_configuration(dict(bad))
            self.assertEqual(answer['min_score'], 1.0)
            self.assertEqual(answer['size_tolerance'], 0.1)
        warnings = ["settings stay as they are: parameter 'association.min_score' = '1.5' must be in [0, 1]",
                    "settings stay as they are: parameter 'association.size_tolerance' = '-1' must be >= 0"]
        self.assertTrue(wait_until(lambda: all(w in launch.output() for w in warnings), 10), launch.output())
        self.assertTrue(wait_until(
            lambda: self.diagnostics.count('ObjectAssociation', 'settings refused') == 2, 10), self.diagnostics.values)
        self.assertEqual(rospy.get_param(node('object_association/association/min_score')), 1.0)
        self.assertEqual(association.get_configuration()['min_score'], 1.0)

        # A new session has what was set.
        self.assertTrue(rospy.ServiceProxy(node('pose_frontend/reset'), Trigger)().success)
        self.assertTrue(wait_until(lambda: self.seen()[0] == 2, 10))
        self.assertEqual(self.seen(), (2, False))
        association.update_configuration({'min_score': 0.25})
        self.assertTrue(wait_until(lambda: self.seen() == (2, True), 10))
        association.close()

    def check_switch(self):
        """Loop closing has one switch: the service's is the setting's."""
        loop = connect('loop_detection')
        self.assertTrue(loop.get_configuration()['enabled'])
        self.assertTrue(rospy.ServiceProxy(node('loop_detection/set_loop_closing'), SetBool)(False).success)
        self.assertTrue(wait_until(lambda: not loop.get_configuration()['enabled'], 10))
        self.assertFalse(rospy.get_param(node('loop_detection/loop/enabled')))
        self.assertTrue(loop.update_configuration({'enabled': True})['enabled'])
        self.assertTrue(rospy.get_param(node('loop_detection/loop/enabled')))
        loop.close()


if __name__ == '__main__':
    rostest.rosrun(PACKAGE, 'settings', 'settings_test')
