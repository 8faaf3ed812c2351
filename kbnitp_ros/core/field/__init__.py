# SPDX-License-Identifier: Apache-2.0
"""The model: grid, world and sensors, and beliefs and observations of them."""
