# SPDX-License-Identifier: Apache-2.0
"""What a robot makes of the messages of its target detector, and of a type that it lacks."""

import json
import os
from pathlib import Path
import subprocess
import sys

from ament_index_python.packages import get_package_share_directory
from kbnitp_ros.nodes.driver import detection_class, read_detection
from laws import for_each
import pytest
from vision_msgs.msg import (
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)

# Of the message as vision_msgs 4.1.1 of ROS 2 Jazzy defines it, with all that it holds.
HASH = '214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968'

ROCK, TARGET, DOUBTFUL = ('rock', 0.9), ('target', 0.5), ('target', 0.49)
NOT_A_NUMBER = ('target', float('nan'))


def array(*objects, sec=0):
    """Return a message with objects, each of them of some classes with their scores."""
    message = Detection2DArray(
        detections=[
            Detection2D(
                results=[
                    ObjectHypothesisWithPose(
                        hypothesis=ObjectHypothesis(class_id=name, score=score)
                    )
                    for name, score in classes
                ]
            )
            for classes in objects
        ]
    )
    message.header.stamp.sec = sec
    return message


@for_each('wanted, objects, seen', [
    ('target', [], False),
    ('target', [[]], False),
    ('target', [[ROCK], [ROCK, DOUBTFUL, NOT_A_NUMBER]], False),
    ('target', [[ROCK], [ROCK, TARGET]], True),
    ('', [[ROCK]], True),
    ('', [[DOUBTFUL]], False),
])  # fmt: skip
def test_a_target_is_an_object_of_the_class_that_is_sure_enough(wanted, objects, seen):
    values = {
        'detection_type': 'detection2d_array',
        'detection_class': wanted,
        'detection_score': 0.5,
    }
    assert detection_class('detection2d_array') is Detection2DArray
    assert read_detection(array(*objects), values) == (seen, None)
    assert read_detection(array(*objects, sec=7), values) == (seen, 7 * 10**9)


def test_arrays_are_those_of_vision_msgs():
    file = Path(get_package_share_directory('vision_msgs'), 'msg/Detection2DArray.json')
    hashes = json.loads(file.read_text())['type_hashes']
    (own,) = (
        each['hash_string'] for each in hashes if each['type_name'].endswith('/Detection2DArray')
    )
    assert own == f'RIHS01_{HASH}'


@pytest.mark.processes
def test_a_robot_without_vision_msgs_says_what_to_install(tmp_path):
    folders = os.environ['PYTHONPATH'].split(os.pathsep)
    others = [each for each in folders if not Path(each, 'vision_msgs').exists()]
    assert others != folders
    given = {
        'agent': 'scout_1',
        'journal': tmp_path / 'scout_1.journal',
        'detection_type': 'detection2d_array',
    }
    command = [sys.executable, '-m', 'kbnitp_ros', 'robot', '--ros-args']
    for name, value in given.items():
        command += ['-p', f'{name}:={value}']
    ended = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(others)},
    )
    assert ended.returncode == 2
    assert (
        "robot: parameter detection_type is 'detection2d_array': type "
        "'vision_msgs/msg/Detection2DArray' has no Python class: No module named 'vision_msgs'; "
        'install vision_msgs, such as by rosdep or as ros-jazzy-vision-msgs, or have the detector '
        'say std_msgs/Bool'
    ) in ended.stderr
    assert not given['journal'].exists()
