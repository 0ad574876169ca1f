"""How policies are updated: BPP in its three forms against PPO, at its own and at BPP's size of steps."""

from __future__ import annotations

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.studies.parts import CLOTH_HANGING, ROPE_WRAPPING, is_better
from maniskill_grpd.experiments.study import Arm, Study

MATCHED_KL = 0.07
"""Mean KL of an update of BPP with its default bounds [nats], docs/results/trust_region_acting.md: what PPO is adapted to."""
HARDLY_CLIPPED = 100.0
"""Norm of the gradient above which it is clipped, the same for all arms: their norms differ, so that a usual one would clip some
in every step and others hardly ever."""

BPP = Arm(name="bpp")
PPO = Arm(name="ppo", algorithm="ppo", partner="bpp", difference="clipping of the ratio by 0.2 in place of the projection")
PPO_MATCHED = Arm(
    name="ppo_matched",
    algorithm="ppo",
    train_options={"clip_kl": MATCHED_KL},
    partner="ppo",
    difference="clipping adapted to the KL of BPP",
)


def _instead(trust_region: str, difference: str) -> Arm:
    return Arm(name=f"bpp_{trust_region}", train_options={"trust_region": trust_region}, partner="bpp", difference=difference)


BPP_VS_PPO = Study(
    name="bpp_vs_ppo",
    title="BPP against PPO",
    question="Does bounding the policy's change make learning better and steadier than clipping? GRPD, the same rollouts, "
    "gradients of any norm. ppo_matched takes steps of the size of BPP's (KL of an update), so that algorithms are compared and "
    "not sizes of steps; the other forms of BPP are the Lagrangian (eq. 66) and the natural gradient (67, 68).",
    tasks=(ROPE_WRAPPING, CLOTH_HANGING),
    arms=(
        BPP,
        _instead("lagrangian", "a Lagrangian in place of the projection"),
        _instead("fisher", "a natural gradient in place of the projection"),
        PPO,
        PPO_MATCHED,
    ),
    metrics=("success_at_end", "return", "training_return", "kl_acting", "iteration_seconds"),
    plots=("curves", "bars"),
    train_options={"max_grad_norm": HARDLY_CLIPPED},
    claims=(
        *(
            Claim(
                text=f"Smaller spread of returns over seeds than {arm.name}",
                source="A.E.4",
                paper="variance -37 %",
                measure="spread",
                metric="return",
                ours=Side(BPP.name, CLOTH_HANGING.name),
                theirs=Side(arm.name, CLOTH_HANGING.name),
                at_most=0.0,
            )
            for arm in (PPO, PPO_MATCHED)
        ),
        *(
            is_better(f"Higher return than {arm.name}", "III.D.c", arm, task, ours=BPP)
            for arm in (PPO, PPO_MATCHED)
            for task in (ROPE_WRAPPING, CLOTH_HANGING)
        ),
    ),
)
