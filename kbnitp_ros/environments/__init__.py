# SPDX-License-Identifier: Apache-2.0
"""
Missions as environments of gymnasium, to learn where the next robot goes.

``import kbnitp_ros.environments`` registers ``kbnitp_ros/Field-v0``, for ``gymnasium.make`` and,
many fields at once, for ``gymnasium.make_vec``.
"""

from kbnitp_ros.plugins import extra

# Of gymnasium only the registry: it imports this package while it is imported itself.
with extra('environments'):
    from gymnasium.envs.registration import register, registry

ID = 'kbnitp_ros/Field-v0'


def register_environments() -> None:
    """Register the environments with gymnasium, once."""
    if ID not in registry:
        module = f'{__name__}.field'
        register(
            ID, entry_point=f'{module}:FieldEnv', vector_entry_point=f'{module}:FieldVectorEnv'
        )


register_environments()
