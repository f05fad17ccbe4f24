"""A camera that slides along a textured wall: color and depth messages whose poses are known, without a renderer."""
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
DISTANCE_M = 1.5
STEP_PX = 3
PERIOD_S = 1.0 / 30.0
FRAME = '/openni_rgb_optical_frame'
STEP_M = STEP_PX * DISTANCE_M / FOCAL


def camera_yaml(width=WIDTH, height=HEIGHT, focal=FOCAL):
    return 'fx: %g\nfy: %g\ncx: %g\ncy: %g\nwidth: %d\nheight: %d\ndistortion: [0, 0, 0, 0, 0]\n' % (
        focal, focal, width / 2.0, height / 2.0, width, height)


def texture():
    """Patches of several sizes, so that every level of an image pyramid has corners."""
    random = np.random.RandomState(7)
    height, width = HEIGHT, WIDTH + 1200
    total = np.zeros((height, width))
    for size in (4, 8, 20):
        patches = random.randint(0, 256, (height // size + 1, width // size + 1))
        total += np.kron(patches, np.ones((size, size)))[:height, :width]
    return (total / 3.0).astype(np.uint8)


WALL = texture()


def image(stamp, pixels, encoding):
    message = Image(height=pixels.shape[0], width=pixels.shape[1], encoding=encoding)
    message.header.stamp = stamp
    message.header.frame_id = FRAME
    message.step = pixels.strides[0]
    message.data = pixels.tobytes()
    return message


def color(stamp, index):
    """The view after `index` steps, rgb8."""
    view = WALL[:, STEP_PX * index:STEP_PX * index + WIDTH]
    return image(stamp, np.ascontiguousarray(np.repeat(view[:, :, None], 3, axis=2)), 'rgb8')


def depth(stamp, value=DISTANCE_M, width=WIDTH, height=HEIGHT):
    return image(stamp, np.full((height, width), value, dtype=np.float32), '32FC1')


def camera_info(stamp, focal=FOCAL):
    info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model='plumb_bob', D=[0.0] * 5)
    info.header.stamp = stamp
    info.header.frame_id = FRAME
    info.K = [focal, 0.0, WIDTH / 2.0, 0.0, focal, HEIGHT / 2.0, 0.0, 0.0, 1.0]
    return info


def stamp_at(time_s):
    return rospy.Time.from_sec(1000.0 + time_s)
