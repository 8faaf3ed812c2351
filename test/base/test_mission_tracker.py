# SPDX-License-Identifier: Apache-2.0
"""Which paths and beliefs a node takes to be of its mission and its estimator."""

from dataclasses import replace

from kbnitp_ros.base.mission_tracker import MissionTracker
from kbnitp_ros.core import Belief, Estimator, Ledger, SensorModel, Unknowns
from kbnitp_ros.messages.beliefs import belief_maps, read_belief_maps
from kbnitp_ros.messages.deployments import read_report
from laws import for_each
import pytest
from samples import GRID, HOME, key, lost

INTERVAL = (0.1, 1.0)


def snapshots(interval=INTERVAL, seed=3, malfunction=0.05, losses=3):
    """Return the beliefs of an estimator that learns the lethality."""
    model = SensorModel(0.5, malfunction)
    prior = Belief.prior(GRID, 0.5, 0.45, 0.8)
    estimator = Estimator(prior, model, 'kappa_bnitp_sampled', Unknowns(interval), seed)
    ledger = Ledger(GRID, 6, estimator)
    told = [read_belief_maps(belief_maps(ledger, 1, 1))]
    for number in range(1, 1 + losses):
        ledger.record_path(key(number), HOME)
        ledger.record_report(*read_report(lost(number)))
        told.append(read_belief_maps(belief_maps(ledger, 1, 1)))
    return told


def test_what_is_learnt_on_the_way_is_no_other_estimators():
    tracker = MissionTracker()
    told = snapshots()
    assert len({snapshot.model for snapshot in told}) == len(told)
    for snapshot in told:
        tracker.check_belief(snapshot, authors=2, known=3)
        assert tracker.accept_belief(snapshot, known=3)


@for_each('other, told', [
    ({'interval': (0.2, 1.0)}, '^unknowns is .*low=0.2.* and 2 nodes publish beliefs'),
    ({'seed': 4}, "^seed is '4': it was '3' before"),
    ({'malfunction': 0.04}, '^model is .*0.04'),
])  # fmt: skip
def test_another_estimator_is_told_by_what_it_was_started_with(other, told):
    tracker = MissionTracker()
    tracker.accept_belief(snapshots()[2], known=3)
    with pytest.raises(ValueError, match=told):
        tracker.check_belief(snapshots(**other)[3], authors=2, known=3)


def test_the_estimator_stays_the_same_when_another_publisher_of_beliefs_leaves():
    """Of the beliefs that are asked for then, that of a stranger may come first."""
    tracker, told = MissionTracker(), snapshots()
    tracker.accept_belief(told[3], known=3)
    tracker.newest = None
    with pytest.raises(ValueError, match='^model is .*0.04'):
        tracker.check_belief(snapshots(malfunction=0.04)[2], authors=2, known=3)
    tracker.check_belief(told[2], authors=2, known=3)
    assert tracker.accept_belief(told[2], known=3)


@for_each('authors', [1, 2])
def test_a_belief_that_holds_more_deployments_than_paths_is_refused(authors):
    """Its publisher may not be counted yet when it comes."""
    tracker, told = MissionTracker(), snapshots()
    for known, snapshot in enumerate(told):
        tracker.accept_belief(snapshot, known)
    with pytest.raises(ValueError, match='^deployments is 40: the paths of only 3 are known'):
        tracker.check_belief(replace(told[-1], deployments=40), authors, known=3)
    assert tracker.newest is told[-1]


def test_the_first_belief_of_a_restarted_planner_may_hold_deployments_of_the_one_before():
    tracker, told = MissionTracker(), snapshots()
    with pytest.raises(ValueError, match='only 0 are known, and 2 nodes publish beliefs: stop'):
        tracker.check_belief(told[2], authors=2, known=0)
    tracker.check_belief(told[2], authors=1, known=0)
    tracker.accept_belief(told[2], known=0)
    # One robot has been sent since.
    tracker.check_belief(told[3], authors=1, known=1)
    with pytest.raises(ValueError, match='only 2 are known'):
        tracker.check_belief(told[3], authors=1, known=0)


def test_paths_of_other_missions_before_the_first_robot_leaves_do_not_matter():
    tracker = MissionTracker()
    tracker.accept_belief(snapshots(losses=0)[0], known=0)
    for foreign in range(2, 202):
        with pytest.raises(ValueError, match='but no belief of that mission was received'):
            tracker.check_path(foreign)
    tracker.check_path(1)
    assert tracker.begin(1) == 1
    with pytest.raises(ValueError, match='and not to the mission begun at 0.000000001'):
        tracker.check_path(2)


def test_the_mission_of_a_belief_with_deployments_is_that_of_an_earlier_prior():
    tracker, (prior, belief) = MissionTracker(), snapshots(losses=1)
    tracker.accept_belief(prior, known=0)
    foreign = replace(belief, mission=0)
    with pytest.raises(ValueError, match='and not to the mission begun at 0.000000001'):
        tracker.check_belief(foreign, authors=2, known=1)
    # An estimator that starts anew states a later mission, before it hears the paths.
    tracker.accept_belief(replace(prior, mission=7), known=1)
    tracker.check_belief(belief, authors=2, known=1)
