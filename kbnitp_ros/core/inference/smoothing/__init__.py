# SPDX-License-Identifier: Apache-2.0
"""All losses of a mission as factors of one posterior, by belief propagation."""

from kbnitp_ros.core.inference.smoothing.smoother import Smoother

__all__ = ['Smoother']
