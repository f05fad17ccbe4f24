"""What the tests of whole launch files share."""
import itertools
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

PACKAGE = 'semantic_topo_loop'

if os.environ.get('STL_DEVEL_PYTHON'):
    sys.path[1:1] = os.environ['STL_DEVEL_PYTHON'].split(os.pathsep)
try:
    import semantic_topo_loop.msg  # noqa: F401, only to say here what is missing where
except ImportError as error:
    built = [directory for directory in sys.path if os.path.isdir(os.path.join(directory, PACKAGE))]
    raise ImportError('%s: no Python messages; PYTHONPATH=%s, STL_DEVEL_PYTHON=%s, found below: %s' % (
        error, os.environ.get('PYTHONPATH'), os.environ.get('STL_DEVEL_PYTHON'), built or 'nothing of the package'))

from semantic_topo_loop.msg import SessionAck, SessionControl  # noqa: E402, after the path is known

RESULT_FILES = ['trajectory_live.txt', 'trajectory.txt', 'keyframes.csv', 'objects.csv', 'loops.csv',
                'loop_verdicts.csv', 'loop_objects.csv', 'associations.csv', 'timing.csv', 'memory.csv', 'summary.json']


class Launch:
    """A launch file, of the package or by its path, in a roslaunch of its own on the test's master; its output is kept."""

    def __init__(self, launch_file, **arguments):
        command = ['roslaunch'] + ([launch_file] if os.path.isabs(launch_file) else [PACKAGE, launch_file])
        command += ['%s:=%s' % argument for argument in sorted(arguments.items())]
        self.lines = []
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        universal_newlines=True, start_new_session=True)
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def wait(self, timeout_s):
        """Whether roslaunch ended by itself."""
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        self.reader.join(10)
        return True

    def stop(self):
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                os.killpg(self.process.pid, signal.SIGKILL)
        self.reader.join(10)

    def output(self):
        return '\n'.join(self.lines)

    def player_finished(self):
        """Whether wait_for_player, which the launch files require, ended with 0 and as the first."""
        text = self.output()
        return 'player: finished' in text and 'exit code' not in text


class DirectoryTest(unittest.TestCase):
    """A test with a directory of its own, removed at its end."""

    @classmethod
    def setUpClass(cls):
        cls.directory = tempfile.mkdtemp(prefix='semantic_topo_loop_')

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.directory)

    @classmethod
    def path(cls, name):
        return os.path.join(cls.directory, name)


class Diagnostics:
    """The last word of each stage on /diagnostics: summaries by stage, values by (stage, key), and all that is not OK."""

    def __init__(self):
        self.summaries, self.values, self.complaints = {}, {}, set()
        self.subscriber = rospy.Subscriber('/diagnostics', DiagnosticArray, self.take)

    def take(self, message):
        for status in message.status:
            stage = status.name.split(': ')[-1]
            self.summaries[stage] = status.message
            if status.level != DiagnosticStatus.OK:
                self.complaints.add((stage, status.message))
            for value in status.values:
                self.values[stage, value.key] = value.value

    def count(self, stage, key):
        return float(self.values.get((stage, key), 0))


class Listener:
    """A stage that only listens: `connect` what it listens to, and playback begins (wait_for:=Listener)."""

    def __init__(self):
        self.subscribers = []
        self.publisher = rospy.Publisher('/%s/session_acks' % PACKAGE, SessionAck, queue_size=10)
        self.control = None
        self.control_subscriber = rospy.Subscriber('/%s/session_control' % PACKAGE, SessionControl, self.take_control)

    def take_control(self, message):
        self.control = message

    def subscribe(self, topic, *arguments, **options):
        self.subscribers.append(rospy.Subscriber(topic, *arguments, **options))

    def is_connected(self):
        return self.control is not None and self.publisher.get_num_connections() > 0 and all(
            subscriber.get_num_connections() > 0 for subscriber in self.subscribers)

    def let_begin(self, timeout_s=60):
        """Once every topic is connected. Whether it is."""
        if not wait_until(self.is_connected, timeout_s):
            return False
        ack = SessionAck(session_id=self.control.session_id, command=self.control.command, stage='Listener')
        ack.header.stamp = self.control.header.stamp
        self.publisher.publish(ack)
        return True

    def close(self):
        for subscriber in self.subscribers + [self.control_subscriber]:
            subscriber.unregister()


def demo(**arguments):
    """The demo on its simulated odometry, without rviz."""
    return Launch('demo.launch', rviz='false', images='false', **arguments)


def run_program(name, *arguments, timeout_s=120):
    """A program of the package: (exit code, output)."""
    done = subprocess.run(['rosrun', PACKAGE, name] + list(arguments), stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, universal_newlines=True, timeout=timeout_s)
    return done.returncode, done.stdout


def run_offline(test, data, output, *arguments):
    """offline on the demo's files."""
    status, text = run_program('offline', '--trajectory', os.path.join(data, 'odometry.txt'), '--detections',
                               os.path.join(data, 'detections.json'), '--camera', os.path.join(data, 'camera.yaml'),
                               '--output', output, *arguments)
    test.assertEqual(status, 0, text)


def rows_of(test, path):
    """All rows of a map, packed ones unpacked, but for the classes: those of objects that went stay."""
    status, text = run_program('inspect_map', path, '--dump')
    test.assertEqual(status, 0, text)
    return [line for line in text.splitlines() if not line.startswith('class ')]


def is_closed(path):
    """Whether a map is there and nobody writes it any more."""
    return os.path.exists(path) and not os.path.exists(path + '-wal')


def differing_files(a, b):
    """Files of two runs that are not the same bytes, timing.csv and memory.csv aside, each with the first lines that differ."""
    names = set(os.listdir(a)) | set(os.listdir(b))
    differing = []
    for name in sorted(names - {'timing.csv', 'memory.csv'}):
        lines = []
        for directory in (a, b):
            try:
                with open(os.path.join(directory, name)) as file:
                    lines.append(file.read().split('\n'))
            except OSError:
                lines.append(['no file'])
        if lines[0] != lines[1]:
            pairs = itertools.zip_longest(*lines, fillvalue='end of file')
            differing.append((name, [pair for pair in pairs if pair[0] != pair[1]][:5]))
    return differing


def wait_until(condition, timeout_s):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return condition()
