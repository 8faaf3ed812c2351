# SPDX-License-Identifier: Apache-2.0
"""Inference of the field from deployments."""
