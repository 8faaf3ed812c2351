# SPDX-License-Identifier: Apache-2.0
"""The estimator node's topic `model`: learnt numbers, and the check against alternatives."""

from __future__ import annotations

from collections.abc import Callable
from concurrent import futures

from kbnitp_msgs.msg import ModelBelief
from kbnitp_ros.core import Ledger
from kbnitp_ros.messages.progress import Checked, model_belief, NOT_CHECKED
from kbnitp_ros.nodes.runtime import qos
from kbnitp_ros.nodes.runtime.node import FieldNode

# Maximum seconds that a node that ends waits for its last check.
LAST = 1.0


class Models:
    """The topic `model`; a thread checks the model of every n-th belief, and of the last."""

    def __init__(self, node: FieldNode, show: Callable[[Checked], None]) -> None:
        self._node, self._show = node, show
        self._every: int = node.values['check_every']
        self._publisher = node.create_publisher(ModelBelief, 'model', qos.LATCHED)
        self._checked = NOT_CHECKED
        # The ledger of the newest belief, and the stamp of that belief.
        self._newest: tuple[Ledger, int] | None = None
        self._running: futures.Future[Checked] | None = None
        # Number of deployments in the belief that a check was begun for last.
        self._begun = -self._every

    def publish(self, ledger: Ledger, stamp: int) -> None:
        """Publish the model of a new belief with the last check, and check it if one is due."""
        self._newest = ledger, stamp
        self._publish()
        if self._running is None and abs(len(ledger.deployments) - self._begun) >= self._every:
            self._running = self._check()

    def finish(self) -> None:
        """Publish the model with the check of the last belief, if it takes less than `LAST`."""
        if self._newest is None:
            return
        ledger, stamp = self._newest
        try:
            if self._running is not None:
                self._checked = self._running.result(LAST)
            if self._checked[1:] != (len(ledger.deployments), stamp):
                self._checked = self._check().result(LAST)
                self._publish()
        except futures.TimeoutError:
            self._node.get_logger().warning(
                f'the model check of the last belief takes more than {LAST:g} s and is left out: '
                'replay shows it'
            )

    def _check(self) -> futures.Future[Checked]:
        """Check the model of the newest belief on a thread of its own."""
        assert self._newest is not None
        ledger, stamp = self._newest
        # A late deployment gives the ledger another estimator, and leaves this one as it is.
        estimator, self._begun = ledger.estimator, len(ledger.deployments)
        deployments = self._begun
        return self._node.compute(
            lambda: Checked(estimator.model_check, deployments, stamp), self._take
        )

    def _take(self, running: futures.Future[Checked]) -> None:
        if running is self._running:
            self._checked, self._running = running.result(), None
            self._publish()
            self._show(self._checked)

    def _publish(self) -> None:
        assert self._newest is not None
        self._publisher.publish(model_belief(*self._newest, self._checked))
