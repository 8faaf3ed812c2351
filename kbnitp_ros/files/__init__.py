# SPDX-License-Identifier: Apache-2.0
"""Files from elsewhere: opened only if they can be read to an end, and YAML of bounded size."""

from kbnitp_ros.files.regular import open_file
from kbnitp_ros.files.yaml_text import NotYamlError, parse_yaml, read_yaml

__all__ = ['NotYamlError', 'open_file', 'parse_yaml', 'read_yaml']
