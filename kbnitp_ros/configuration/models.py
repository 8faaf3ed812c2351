# SPDX-License-Identifier: Apache-2.0
"""How the parameters say that sensors and robots behave, and what of it is to be learnt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
import itertools
from typing import Any

from kbnitp_ros.configuration.table import LEARN
from kbnitp_ros.core import (
    Beta,
    Clustering,
    Dynamics,
    Execution,
    Grid,
    HAZARD_RATES,
    SensorModel,
    Unknowns,
)


def sensor_model_of(values: Mapping[str, Any]) -> SensorModel:
    """Return the sensor model that these parameters describe."""
    return SensorModel(
        **{each.name: values[f'sensor.{each.name}'] for each in fields(SensorModel)}
    )


def priors_of(values: Mapping[str, Any]) -> dict[str, Beta]:
    """Return the priors of learnable numbers and rates, by name."""
    learn = values['learn.numbers']
    if len(set(learn)) < len(learn):
        raise ValueError(
            f'parameter learn.numbers is {list(learn)}: it must name each number once'
        )
    priors = {}
    for name in LEARN:
        believed = values[f'learn.{name}']
        try:
            if len(believed) not in (2, 4):
                raise ValueError('it must be low and high, or low, high, a and b')
            priors[name] = Beta(**dict(zip(('low', 'high', 'a', 'b'), believed)))
        except ValueError as error:
            raise ValueError(f'parameter learn.{name} is {list(believed)}: {error}') from error
    return priors


def unknowns_of(values: Mapping[str, Any]) -> Unknowns:
    """Return which numbers these parameters leave to be learnt."""
    priors, rates = priors_of(values), [*itertools.chain(*HAZARD_RATES.values())]
    return Unknowns(
        **{name: priors[name] for name in values['learn.numbers'] if name not in rates}
    )


def dynamics_of(values: Mapping[str, Any]) -> Dynamics:
    """Return how hazards change by these parameters."""
    try:
        kind = values['hazards.dynamics']
        rates = {
            name: values[f'hazards.{name}'] for name in itertools.chain(*HAZARD_RATES.values())
        }
        # Simulated agents learn nothing.
        for name, prior in priors_of(values).items() if 'learn.numbers' in values else ():
            if name in values['learn.numbers'] and rates.get(name):
                raise ValueError(
                    f'{name} is {rates[name]}, and learn.numbers has it: leave it at 0'
                )
            own = next((each for each, names in HAZARD_RATES.items() if name in names), kind)
            if name in values['learn.numbers'] and kind not in (own, 'learn'):
                raise ValueError(
                    f'dynamics is {kind}, and learn.numbers has {name}: only {own} hazards have it'
                )
            is_open = kind == 'learn' and not rates.get(name)
            if name in rates and (is_open or name in values['learn.numbers']):
                rates[name] = prior
        return Dynamics(kind, **rates)
    except ValueError as error:
        raise ValueError(f'parameter hazards.{error}') from error


def true_dynamics(values: Mapping[str, Any]) -> Dynamics:
    """Return the true dynamics of hazards; refuse an unknown kind or rate."""
    dynamics = dynamics_of(values)
    try:
        dynamics.known_rates()
    except ValueError as error:
        raise ValueError(
            f'parameter hazards.{error}, for agents; give the estimator another one, such as '
            'estimator:hazards.dynamics=learn'
        ) from error
    return dynamics


def clustering_of(values: Mapping[str, Any], grid: Grid) -> Clustering | None:
    """Return how hazards cluster by these parameters; None if they are independent."""
    coupling = values['prior.clustering']
    return Clustering(grid, coupling) if coupling else None


def execution_of(values: Mapping[str, Any]) -> Execution:
    """Return how simulated robots depart from their orders."""
    if values['silent_loss'] and values['contact_probability'] > 0.0:
        raise ValueError(
            f'contact_probability is {values["contact_probability"]}, and silent_loss is true: '
            'simulated robots that are lost in silence were not heard before either; set one of '
            'them'
        )
    return Execution(
        detour=values['detour_probability'],
        early_return=values['early_return_probability'],
        contact=values['contact_probability'],
        camera_failure=values['camera_failure_probability'],
    )
