# SPDX-License-Identifier: Apache-2.0
"""The posterior of the field and of unknown numbers, by many Gibbs chains."""

from kbnitp_ros.core.inference.sampling.sampler import Sampler

__all__ = ['Sampler']
