# SPDX-License-Identifier: Apache-2.0
"""What a robot survives and what it reports."""

from itertools import product
import math

from kbnitp_ros.core import SensorModel
from laws import for_each
import numpy as np
import pytest

FIELDS = ('lethality', 'malfunction', 'false_negative', 'true_positive', 'false_positive')


def test_defaults_are_those_of_the_paper():
    model = SensorModel(0.5)
    assert [getattr(model, name) for name in FIELDS] == [0.5, 0.05, 0.05, 0.95, 0.05]


def test_survival_of_a_step():
    model = SensorModel(lethality=0.6, malfunction=0.1, false_negative=0.2)
    np.testing.assert_allclose(model.survival([0, 1]), [0.9, 0.9 * (1 - 0.6 * 0.8)], rtol=1e-15)
    np.testing.assert_allclose(
        model.survival(np.array([[True], [False]])), [[0.9 * (1 - 0.6 * 0.8)], [0.9]], rtol=1e-15
    )


@for_each(
    'lethality, expected',
    [(0.0, 0.95), (0.01, 0.95 * 0.9905), (0.5, 0.95 * 0.525), (1.0, 0.95 * 0.05)],
)
def test_survival_of_a_hazard(lethality, expected):
    assert float(SensorModel(lethality).survival(1)) == pytest.approx(expected, abs=1e-15)


def test_reading_of_a_cell():
    model = SensorModel(0.5, true_positive=0.8, false_positive=0.3)
    assert model.reading([0, 1, 1]).tolist() == [0.3, 0.8, 0.8]
    assert float(model.reading(True)) == 0.8


@for_each('field, value', product(FIELDS, [-0.01, 1.01, math.nan, math.inf, -math.inf]))
def test_what_is_no_probability_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=rf'{field} is {value}.*\[0, 1\]'):
        SensorModel(**{'lethality': 0.5, field: value})


@for_each('field', FIELDS)
def test_certainties_are_allowed(field):
    for value in (0, 1):
        assert getattr(SensorModel(**{'lethality': 0.5, field: value}), field) == value


def test_models_compare_and_cannot_be_changed():
    assert SensorModel(0.5) == SensorModel(0.5) != SensorModel(0.6)
    with pytest.raises(AttributeError):
        SensorModel(0.5).lethality = 0.9
