# SPDX-License-Identifier: Apache-2.0
"""A share of the campaign: nothing that somebody sends stops a mission or makes it wrong."""

from __future__ import annotations

from forged import run_forged
from forger import FORGERIES
import pytest

# Of the messages of the campaign: its flood alone takes 20 s.
SCALE = 0.1


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory):
    """Run a mission that nothing is sent to."""
    return run_forged(tmp_path_factory.mktemp('undisturbed'), ())


@pytest.mark.full
@pytest.mark.parametrize('kind', FORGERIES)
def test_what_is_forged_is_refused_and_changes_nothing(tmp_path, undisturbed, kind):
    outcome = run_forged(tmp_path, [kind], SCALE)
    outcome.compare_memory(undisturbed)
    assert not outcome.findings, outcome


def test_a_mission_survives_all_of_it(tmp_path, undisturbed):
    outcome = run_forged(tmp_path, FORGERIES, SCALE, seed=2)
    outcome.compare_memory(undisturbed)
    assert not outcome.findings, outcome
