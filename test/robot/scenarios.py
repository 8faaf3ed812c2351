# SPDX-License-Identifier: Apache-2.0
"""Faults of a robot's position, its clock and Nav2, and how often it is vouched for."""

from dataclasses import dataclass, replace
from itertools import product

from ground import NEAR, run, Scenario

# Seconds until a jump is back; None for never.
BACK = (1.0, 3.0, 6.0, None)

CLEAN = {
    'clean': Scenario(),
    'clean, 20 Hz': Scenario(rate=20.0),
    'clean, 1 Hz': Scenario(rate=1.0),
    'clean, .25 cells a second': Scenario(speed=0.25),
    'clean, 2 cells a second, 20 Hz': Scenario(speed=2.0, rate=20.0),
    'clean, maximum speed unknown': Scenario(told_speed=0.0),
    **{f'clean, {driver}': Scenario(driver=driver) for driver in (
        'follow_waypoints', 'navigate_through_poses', 'follow_path',
    )},
    'three robots': Scenario(robots=3),
}  # fmt: skip
CORRECTIONS = {
    f'corrections of {size:g} a second': Scenario(correction=size) for size in (0.1, 0.2, 0.4, 0.6)
}
JUMPS = {
    f'jump of {size:g}, {"lasting" if back is None else f"back after {back:g} s"}': Scenario(
        jumps=((size, back),)
    )
    for size, back in product((0.4, 0.6, 1.41, 2.0, 3.0, 5.0), BACK)
} | {
    'jump of 1, lasting': Scenario(jumps=((1.0, None),)),
    'two jumps of .6': Scenario(jumps=((0.6, None), (0.6, None))),
    'two jumps of 2': Scenario(jumps=((2.0, None), (2.0, None))),
    'jump of 1 with a turn': Scenario(jumps=((1.0, None),), turn=0.3),
    'jump of 2, maximum speed unknown': Scenario(jumps=((2.0, None),), told_speed=0.0),
    'jump of 1 with corrections of .1': Scenario(jumps=((1.0, None),), correction=0.1),
    'wrong by 1 from the start, put right': Scenario(wrong=1.0),
    'wrong by 3 from the start, put right': Scenario(wrong=3.0),
}
# Jumps of odometry that the localization repeats: they last, are back by themselves, or are
# corrected by the localization.
SLIPS = {
    f'odometry jumps by {size:g}, {how}{on}': Scenario(
        slips=((size, back, corrected),), **({'driver': driver} if driver else {})
    )
    for size in (1.0, 2.0, 5.0)
    for how, back, corrected in (
        ('lasting', None, None), ('back after 4 s', 4.0, None), ('corrected after 4 s', None, 4.0),
    )
    for on, driver in (
        ('', ''),
        *((f', {name}', name) for name in NEAR if size == 2.0),
    )
} | {
    'odometry jumps by 2, then by 1': Scenario(slips=((2.0, None, None), (1.0, None, None))),
    'odometry jumps by 2 and back, twice': Scenario(slips=((2.0, 3.0, None), (2.0, 3.0, None))),
    'odometry jumps by 2, 20 Hz': Scenario(slips=((2.0, None, None),), rate=20.0),
}  # fmt: skip
OUTLIERS = {f'{share:.1%} of poses are off': Scenario(outliers=share) for share in (0.005, 0.02)}
SILENCE = {
    f'no poses for {seconds:g} s{" at the departure" if is_early else ""}': Scenario(
        silence=seconds, is_early=is_early
    )
    for seconds, is_early in product((2.0, 8.0, 60.0), (False, True))
}
NAV2 = {f'Nav2: {wrong}': Scenario(nav2=wrong) for wrong in (
    'reject', 'abort', 'cancel', 'die', 'lie', 'preempt',
)} | {
    'carried home': Scenario(carried='seen'),
    'carried home without poses': Scenario(carried='silent'),
    'carried home while the wheels turn': Scenario(carried='wheels'),
    'node killed for 2 s': Scenario(killed=2.0),
    'node killed for 20 s': Scenario(killed=20.0),
    'clock behind by .3 s': Scenario(ahead=-0.3),
    'clock behind by .8 s': Scenario(ahead=-0.8),
    'clock behind by 1.5 s': Scenario(ahead=-1.5),
    'clock ahead by 1 s': Scenario(ahead=1.0),
    'clock ahead by 30 s': Scenario(ahead=30.0),
    'clock ahead by 300 s': Scenario(ahead=300.0),
}  # fmt: skip

SCENARIOS = CLEAN | CORRECTIONS | JUMPS | SLIPS | OUTLIERS | SILENCE | NAV2

# Beyond any rule: docs/robots.md names them.
BEYOND = {
    'jump of .6 with corrections of .2': Scenario(jumps=((0.6, None),), correction=0.2),
    'drift of .05 a second, never corrected': Scenario(drift=0.05),
    'odometry jumps by 2, lasting, 1 Hz': Scenario(slips=((2.0, None, None),), rate=1.0),
    'odometry jumps by .5, lasting': Scenario(slips=((0.5, None, None),)),
}


@dataclass
class Counts:
    """Numbers of walks, of cells and of steps."""

    walks: int = 0
    home: int = 0
    entered: int = 0
    reported: int = 0
    vouched: int = 0
    # Vouched for and not entered; reported and not entered; readings of other cells.
    false: int = 0
    false_before: int = 0
    misread: int = 0
    read: int = 0


def count(scenario, walks, first=0):
    """Return the counts of a scenario over some walks."""
    total = Counts()
    for seed in range(first, first + walks):
        for result in run(scenario, seed):
            total.walks += 1
            total.entered += result.entered
            if result.deployment is None:
                continue
            total.home += 1
            for step, is_true, is_read in zip(
                result.deployment.steps, result.is_true, result.is_read
            ):
                total.reported += 1
                total.vouched += step.is_entered
                total.false += step.is_entered and not is_true
                total.false_before += not is_true
                total.read += step.is_entered and step.reading >= 0
                total.misread += step.is_entered and not is_read
    return total


def without_odometry(scenario):
    return replace(scenario, odometry=False)
