# SPDX-License-Identifier: Apache-2.0
"""QoS profiles of all topics, and of the recorder's subscriptions to foreign topics."""

from __future__ import annotations

from functools import partial

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

# Fast DDS keeps at most 5000 samples of a topic unless a profile says otherwise: it accepts a
# deeper history and then drops messages silently.
DEPTH = 5000

kept = partial(
    QoSProfile,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)

# Paths and reports: nodes that join late receive the whole mission.
EVIDENCE = kept(depth=DEPTH)

# Beliefs and maps, as in REP-2003: nodes that join late receive the newest.
LATCHED = kept(depth=1)

# Standings: a reader that misses some subscribes again, and then receives all.
STANDINGS = kept(depth=100)

# Signs of life of recorders.
ALIVE = QoSProfile(depth=10)

DIAGNOSTICS = QoSProfile(depth=10)

# Poses, as in tf2; static poses are kept for nodes that join late.
POSES = QoSProfile(depth=100)
LATCHED_POSES = kept(depth=100)

# Sensor data, which is never sent again.
READINGS = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


def unread_kept(offered: QoSProfile) -> QoSProfile:
    """Return a subscription's profile that receives all messages of a publisher."""
    # With an unlimited history no message is dropped: a reliable publisher repeats lost ones.
    reliable = offered.reliability == ReliabilityPolicy.RELIABLE
    latched = offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def lacking(offered: QoSProfile) -> str:
    """Describe the policies incompatible with `EVIDENCE` subscriptions; empty if none is."""
    words = []
    if offered.reliability == ReliabilityPolicy.BEST_EFFORT:
        words.append('with best effort')
    if offered.durability == DurabilityPolicy.VOLATILE:
        words.append('volatile')
    return ' and '.join(words)
