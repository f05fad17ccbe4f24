"""Writes the images of a TUM folder (rgb.txt, depth.txt, depth in 1/5000 m) as a bag in the layout of the official ones."""

import sys

import numpy
import rosbag
import rospy
from PIL import Image as File
from sensor_msgs.msg import CameraInfo, Image

DEPTH_SCALE = 5000.0


def message(path, stamp, encoding, convert=numpy.asarray):
    pixels = convert(numpy.asarray(File.open(path)))
    image = Image(height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, data=pixels.tobytes())
    image.step = len(image.data) // image.height
    image.header.stamp = rospy.Time.from_sec(float(stamp))
    image.header.frame_id = "openni_rgb_optical_frame"
    return image


def main():
    folder, bag_file = sys.argv[1:]

    def files(kind):
        with open(f"{folder}/{kind}.txt") as index:
            return [line.split()[:2] for line in index if not line.startswith("#")]

    with rosbag.Bag(bag_file, "w") as bag:
        for stamp, path in files("depth"):
            depth = message(f"{folder}/{path}", stamp, "32FC1", lambda raw: (raw / DEPTH_SCALE).astype(numpy.float32))
            bag.write("/camera/depth/image", depth, depth.header.stamp)
        for stamp, path in files("rgb"):
            color = message(f"{folder}/{path}", stamp, "rgb8")
            bag.write("/camera/rgb/camera_info", CameraInfo(header=color.header), color.header.stamp)
            bag.write("/camera/rgb/image_color", color, color.header.stamp)


if __name__ == "__main__":
    main()
