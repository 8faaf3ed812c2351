# SPDX-License-Identifier: Apache-2.0
"""The method that samples: one sampler for static hazards, another where they do not stay."""

from __future__ import annotations

from kbnitp_ros.core.field import Belief, Clustering, Dynamics, SensorModel, STATIC, Unknowns
from kbnitp_ros.core.inference.sampling.cause_sampler import CauseSampler
from kbnitp_ros.core.inference.sampling.sampler import Sampler


class Sampled:
    """
    The method kappa_bnitp_sampled.

    Attributes
    ----------
    learns, version, takes_lost_at, dynamics, clusters
        As of a `Method`.

    """

    learns = Sampler.learns
    version = Sampler.version
    takes_lost_at = Sampler.takes_lost_at
    dynamics = ('changing', 'used_up')
    clusters = True

    def __call__(
        self,
        belief: Belief,
        model: SensorModel,
        unknowns: Unknowns,
        seed: int,
        dynamics: Dynamics = STATIC,
        /,
        *,
        clustering: Clustering | None = None,
    ) -> Sampler | CauseSampler:
        """
        Return the inference before the first deployment.

        Raises
        ------
        ValueError
            If numbers are not known where hazards do not stay, or as of a `Sampler`.

        """
        if dynamics.effect == 'static':
            return Sampler(belief, model, unknowns, seed, clustering)
        if unknowns.priors:
            raise ValueError(
                f'{" and ".join(unknowns.priors)} cannot be unknown where hazards are '
                f'{dynamics.effect}: numbers are learnt of static hazards alone'
            )
        return CauseSampler(belief, model, dynamics, seed)
