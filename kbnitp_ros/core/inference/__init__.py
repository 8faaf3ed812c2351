# SPDX-License-Identifier: Apache-2.0
"""What is learnt of the field: the belief after deployments."""
