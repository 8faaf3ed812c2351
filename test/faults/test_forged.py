# SPDX-License-Identifier: Apache-2.0
"""A share of the campaign: nothing that somebody sends stops a mission or makes it wrong."""

from extent import some
from forged import run_forged
from forger import FORGERIES
import pytest

pytestmark = pytest.mark.processes

# Of the messages of the campaign: its flood alone takes 20 s.
SCALE = 0.1


@pytest.fixture(scope='module')
def undisturbed(processes, tmp_path_factory):
    """Run a mission that nothing is sent to."""
    return run_forged(tmp_path_factory.mktemp('undisturbed'), (), processes=processes)


@pytest.mark.parametrize('kind', some(sorted(FORGERIES, key='random'.__ne__), len(FORGERIES)))
def test_what_is_forged_is_refused_and_changes_nothing(tmp_path, processes, undisturbed, kind):
    outcome = run_forged(tmp_path, [kind], SCALE, processes=processes)
    outcome.compare_memory(undisturbed)
    assert not outcome.findings, outcome


@pytest.mark.full
def test_a_mission_survives_all_of_it(tmp_path, processes, undisturbed):
    outcome = run_forged(tmp_path, FORGERIES, SCALE, seed=2, processes=processes)
    outcome.compare_memory(undisturbed)
    assert not outcome.findings, outcome


@pytest.mark.full
@pytest.mark.campaign
def test_a_mission_goes_on_among_ten_thousand_topics(tmp_path):
    outcome = run_forged(tmp_path, ['topics'], 10.0)
    assert not outcome.findings, outcome
