# SPDX-License-Identifier: Apache-2.0
"""No robot leaves on a path that nobody could read in the log after a crash."""

from mission import NAMESPACE
from onlooker import AGENT
from schedule import NODES

# The search for a path takes long enough to stop the recorder meanwhile.
PARAMETERS = {
    'grid.width': 6, 'grid.height': 6, 'max_steps': 14, 'robots': 4, 'beam_width': 40, 'seed': 13,
}  # fmt: skip


def test_a_path_that_only_the_agent_remembers_is_not_taken(set_out):
    mission = set_out(PARAMETERS)
    mission.start(*NODES)
    topic = f'{NAMESPACE}/{AGENT}/path'

    def readers():
        return {each.node_name for each in mission.node.get_subscriptions_info_by_topic(topic)}

    mission.until(
        lambda: mission.onlooker.held == 0 and readers() >= {'agent', 'recorder'}, 'prior'
    )
    mission.halt('recorder')
    mission.until(lambda: mission.onlooker.evidence.paths, 'path')
    for name in ('recorder', 'estimator', 'planner'):
        mission.kill(name)
    # The prior of another estimator has another stamp, and so has the first path of this planner.
    mission.start('estimator', 'planner', 'recorder')
    mission.until_over()
    assert mission.unused == 1
    assert not mission.findings()
