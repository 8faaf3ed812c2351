# SPDX-License-Identifier: Apache-2.0
"""
Methods of which more is known than what holds of all.

What a test says of every method, whatever is registered, it says of `METHODS`.
"""

# They condition on a loss, so they notice one that cannot be.
LEARN_FROM_LOSSES = (
    'relaxed_itp',
    'relaxed_bnitp',
    'kappa_bnitp_published',
    'kappa_bnitp',
    'kappa_bnitp_sampled',
)
