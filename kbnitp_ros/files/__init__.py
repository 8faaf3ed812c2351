# SPDX-License-Identifier: Apache-2.0
"""YAML, files of the package, and words for what went wrong."""

from kbnitp_ros.files.share import installed, share
from kbnitp_ros.files.words import counted, in_words, naming, some
from kbnitp_ros.files.yaml_text import NotYamlError, parse_yaml, read_yaml

__all__ = [
    'NotYamlError',
    'counted',
    'in_words',
    'installed',
    'naming',
    'parse_yaml',
    'read_yaml',
    'share',
    'some',
]
