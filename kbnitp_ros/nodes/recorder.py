# SPDX-License-Identifier: Apache-2.0
"""The recorder: writes every message of the mission to a log, as it came off the wire."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from importlib import import_module
import sys
from typing import Any

from kbnitp_ros.log.schema import qos_profiles_yaml
from kbnitp_ros.log.writer import LogWriter
from kbnitp_ros.nodes import qos
from kbnitp_ros.nodes.shell import run, Shell

# Recorded from outside the mission's namespace, and left out inside it.
SHARED = ('/clock', '/tf', '/tf_static')
LEFT_OUT = ('/parameter_events', '/rosout')

REPORT = 'kbnitp_msgs/msg/DeploymentReport'


class RecorderNode(Shell):
    """Record all topics of this namespace, each as soon as it is published."""

    def __init__(self) -> None:
        super().__init__('recorder')
        self._log = LogWriter(self.values['file'])
        self._namespace = self.get_namespace().rstrip('/') + '/'
        self._topics: set[str] = set()
        self.create_poll(self._discover)

    def close(self) -> None:
        """Finish the file."""
        super().close()
        self._log.close()

    def _discover(self) -> None:
        """Subscribe to what is published and not recorded yet."""
        if not self._log.path.exists():
            raise FileNotFoundError(f'{self._log.path} is gone: it was removed while recording')
        # The estimator publishes as soon as belief has its readers, so the maps, which it created
        # before, must be known and subscribed to before belief is: two looks that agree show all
        # that was created before anything they show, and belief comes last backwards.
        found: dict[str, Any] = {}
        while found.keys() != (looked := self._published()).keys():
            found = looked
        for topic in sorted(found, reverse=True):
            self._record(topic, found[topic])

    def _published(self) -> dict[str, Any]:
        """Return the publishers of each topic that is to be recorded and is not yet."""
        topics = [topic for topic, _ in self.get_topic_names_and_types() if self._is_new(topic)]
        publishers = {topic: self.get_publishers_info_by_topic(topic) for topic in topics}
        return {topic: known for topic, known in publishers.items() if known}

    def _is_new(self, topic: str) -> bool:
        ours = topic in SHARED or (topic.startswith(self._namespace) and topic not in LEFT_OUT)
        return ours and topic not in self._topics

    def _record(self, topic: str, publishers: Sequence[Any]) -> None:
        self._topics.add(topic)
        type_name = publishers[0].topic_type
        offered = [publisher.qos_profile for publisher in publishers]
        try:
            message_type = message_class(type_name)
            self._log.add_topic(topic, type_name, qos_profiles_yaml(offered))
        except LookupError as error:
            self.diagnostics.refuse(topic, error)
            return
        self.create_subscription(
            message_type,
            topic,
            partial(self._on_message, topic, type_name),
            qos.lossless(offered),
            raw=True,
        )
        self.diagnostics.state = f'recording {len(self._topics)} topics'

    def _on_message(self, topic: str, type_name: str, data: bytes, info: Any) -> None:
        self._log.write(topic, data, info['received_timestamp'], info['source_timestamp'])
        if type_name == REPORT:
            self._log.sync()
        self.diagnostics.accept()


def message_class(type_name: str) -> type:
    """
    Return the Python class of a message type, such as 'nav_msgs/msg/Path'.

    Raises
    ------
    LookupError
        If it is not installed.

    """
    try:
        package, kind, name = type_name.split('/')
        return getattr(import_module(f'{package}.{kind}'), name)
    except (ValueError, ImportError, AttributeError) as error:
        raise LookupError(f'type {type_name} is not installed: {error}') from error


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder; return the exit code."""
    return run('recorder', RecorderNode, args, linger=0.6)


if __name__ == '__main__':
    sys.exit(main())
