# SPDX-License-Identifier: Apache-2.0
"""What is: the grid, the world, the sensors, and what is believed and observed of them."""

from kbnitp_ros.core.field.belief import Belief
from kbnitp_ros.core.field.check import (
    cost,
    each_of,
    frozen,
    generator,
    in_short,
    probability,
    typed,
    typed_fields,
    Value,
    whole_number,
    yes_or_no,
)
from kbnitp_ros.core.field.clustering import Clustering, LEARNT_COUPLING, STRONGEST
from kbnitp_ros.core.field.compiled import compiled, inlined, while_compiling
from kbnitp_ros.core.field.dynamics import (
    appearance,
    Dynamics,
    HAZARD_RATES,
    HAZARDS,
    joint_after_change,
    joint_after_moves,
    neighbors_to_move_to,
    Rates,
    STATIC,
)
from kbnitp_ros.core.field.execution import AS_ORDERED, Execution, Traverse
from kbnitp_ros.core.field.grid import Grid, longest
from kbnitp_ros.core.field.metrics import binary_entropy, brier_score, log_loss, surprisal
from kbnitp_ros.core.field.observation import (
    as_path,
    lost_after_contact,
    Observation,
    Visits,
)
from kbnitp_ros.core.field.sensor import (
    log_predicted_survival,
    of_each,
    ORDINARY,
    RobotType,
    SensorModel,
    sum_of_others,
    times_log,
)
from kbnitp_ros.core.field.unknowns import ALL_KNOWN, Beta, Bins, Learnt, Unknowns
from kbnitp_ros.core.field.world import World

__all__ = [
    'ALL_KNOWN',
    'AS_ORDERED',
    'HAZARDS',
    'HAZARD_RATES',
    'LEARNT_COUPLING',
    'ORDINARY',
    'STATIC',
    'STRONGEST',
    'Belief',
    'Beta',
    'Bins',
    'Clustering',
    'Dynamics',
    'Execution',
    'Grid',
    'Learnt',
    'Observation',
    'Rates',
    'RobotType',
    'SensorModel',
    'Traverse',
    'Unknowns',
    'Value',
    'Visits',
    'World',
    'appearance',
    'as_path',
    'binary_entropy',
    'brier_score',
    'compiled',
    'cost',
    'each_of',
    'frozen',
    'generator',
    'in_short',
    'inlined',
    'joint_after_change',
    'joint_after_moves',
    'log_loss',
    'log_predicted_survival',
    'longest',
    'lost_after_contact',
    'neighbors_to_move_to',
    'of_each',
    'probability',
    'sum_of_others',
    'surprisal',
    'times_log',
    'typed',
    'typed_fields',
    'while_compiling',
    'whole_number',
    'yes_or_no',
]
