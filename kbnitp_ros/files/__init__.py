# SPDX-License-Identifier: Apache-2.0
"""Files from elsewhere: opened only if they have an end, YAML of bounded size, what went wrong."""

from kbnitp_ros.files.regular import open_file
from kbnitp_ros.files.share import installed, share
from kbnitp_ros.files.words import counted, in_words, naming, some
from kbnitp_ros.files.yaml_text import KeyTwiceError, NotYamlError, parse_yaml, read_yaml

__all__ = [
    'KeyTwiceError',
    'NotYamlError',
    'counted',
    'in_words',
    'installed',
    'naming',
    'open_file',
    'parse_yaml',
    'read_yaml',
    'share',
    'some',
]
