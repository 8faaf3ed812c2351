# SPDX-License-Identifier: Apache-2.0
"""The grids and models on record, compared with the beliefs that they show."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any

from kbnitp_ros.bag import LoggedMessage
from kbnitp_ros.core import DeploymentKey, Grid, Ledger
from kbnitp_ros.log.compare import content_digest, Difference, differences
from kbnitp_ros.log.replay_report import BeliefFinding, ReplayReport, TOLERANCE
from kbnitp_ros.log.roles import Role, VIEWS
from kbnitp_ros.messages.grids import occupancy_fields
from kbnitp_ros.messages.headers import from_stamp
from kbnitp_ros.messages.models import model_fields

# Which fields a grid has.
ANY_GRID = occupancy_fields(Grid(1, 1), [0.0], 0)

# The belief that a view is of, and the fields of a model or the digest of a grid.
Expected = tuple['DeploymentKey | None', Any]


class ReplayedViews:
    """The views on record, and those of the beliefs that were computed."""

    def __init__(self) -> None:
        # The index, stamp and content of each, by its role and topic.
        self._recorded: dict[tuple[str, str], list[tuple[int, int, Any]]] = defaultdict(list)
        # By role and stamp; beliefs may share one.
        self._expected: dict[tuple[str, int], list[Expected]] = defaultdict(list)
        # How many beliefs of a stamp are on record and were not computed.
        self._unknown: Counter[int] = Counter()

    def note(self, role: Role, logged: LoggedMessage) -> None:
        """Keep a view until all beliefs are computed; of a grid what identifies its content."""
        message = logged.message
        kept = message if role.name == 'model' else grid_digest(message)
        view = logged.index, from_stamp(message.header.stamp), kept
        self._recorded[role.name, logged.topic].append(view)

    def expect(self, ledger: Ledger, seen: Any, newest: DeploymentKey | None, stamp: int) -> None:
        """Take note of the views of a ledger's belief, whose maps are those of `seen`."""
        for name in VIEWS:
            grid = occupancy_fields(ledger.grid, getattr(seen, name), stamp)
            self._expected[f'belief/{name}', stamp].append((newest, grid_digest(grid)))
        if ledger.estimator.parameters or ledger.estimator.check.alternatives:
            fields = model_fields(ledger, stamp)
            # A sentence that rounds numbers, which another processor may round otherwise.
            del fields.reason
            self._expected['model', stamp].append((newest, fields))

    def pass_over(self, stamp: int) -> None:
        """Take note of a belief on record that was not computed: its views are not known."""
        self._unknown[stamp] += 1

    def compare(self, report: ReplayReport) -> None:
        """Compare each view with those of the beliefs of its time; some may be missing."""
        for (role, topic), views in self._recorded.items():
            by_stamp: dict[int, list[tuple[int, Any]]] = defaultdict(list)
            for index, stamp, view in views:
                by_stamp[stamp].append((index, view))
            for stamp, indexed in by_stamp.items():
                expected = self._expected.get((role, stamp), [])
                unseen, others = [*expected], []
                for index, view in indexed:
                    alike = [n for n, each in enumerate(unseen) if not differs(view, each[1])]
                    if alike:
                        del unseen[alike[0]]
                    elif all(differs(view, computed) for _, computed in expected):
                        others.append((index, view))
                        continue
                    report.compared[topic] += 1
                del others[: self._unknown[stamp]]
                for (index, view), (newest, computed) in zip(others, unseen):
                    report.compared[topic] += 1
                    report.add(BeliefFinding(topic, index, newest, differs(view, computed)))


def differs(view: Any, computed: Any) -> tuple[Difference, ...]:
    """Return how a view differs from that of a belief; of grids only the digests are known."""
    if not isinstance(view, bytes):
        return tuple(differences(view, computed, TOLERANCE))
    return () if view == computed else (Difference('data', 'is not that of the belief'),)


def grid_digest(view: Any) -> bytes:
    """Return a digest of a nav_msgs/OccupancyGrid or its fields."""
    return content_digest(view, ANY_GRID)
