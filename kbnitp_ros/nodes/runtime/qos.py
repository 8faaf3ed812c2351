# SPDX-License-Identifier: Apache-2.0
"""The quality of service of every topic, and how the recorder meets that of others."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# Fast DDS keeps at most 5000 samples of a topic unless a profile says otherwise: it accepts a
# deeper history and then loses messages without a word.
DEPTH = 5000

# Paths and reports: who joins late gets the whole mission.
EVIDENCE = QoSProfile(
    depth=DEPTH,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# Beliefs and maps, as REP-2003 has them: who joins late gets the newest.
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

DIAGNOSTICS = QoSProfile(depth=10)

# Poses, as tf2 has them; those that never change are kept for who joins late.
POSES = QoSProfile(depth=100)
LATCHED_POSES = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# What sensors say, which nobody sends again.
READINGS = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


def unread_kept(offered: QoSProfile) -> QoSProfile:
    """Return the profile of a subscription that gets all that such a publisher can give."""
    # With a history that is kept whole a reliable publisher sends again what found no place.
    reliable = offered.reliability == ReliabilityPolicy.RELIABLE
    latched = offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def lacking(offered: QoSProfile) -> str:
    """Return in words what keeps subscriptions to `EVIDENCE` from hearing a publisher, if any."""
    words = []
    if offered.reliability == ReliabilityPolicy.BEST_EFFORT:
        words.append('with best effort')
    if offered.durability == DurabilityPolicy.VOLATILE:
        words.append('volatile')
    return ' and '.join(words)
