"""Campaigns of mirrors in one piece, put together as segments of one mirror."""

from dataclasses import replace

import numpy as np

from helpers.balanced import LAYOUT, RING, campaign_of
from truenewton.records.cycle import Segment, sums_of
from truenewton.statics.layout import layout
from truenewton.statics.load import Load

SCALES = (1.0, 1.5, 0.8)  # of all forces and weights of each segment


def pieces(count=2, noise=1e-3, **options):
    """Return campaigns of one body each: other places, names, alpha, weights; and their truths."""
    made = []
    for k, scale in enumerate(SCALES[:count]):
        loads = (Load("bare"), replace(RING, added_error=0.005 + 0.001 * k))
        turn = 2 * np.pi * k / count
        place = layout(
            LAYOUT.x + 0.3 * np.cos(turn),
            LAYOUT.y + 0.3 * np.sin(turn),
            nz=LAYOUT.nz,
            id=LAYOUT.id + 100 * (k + 1),
        )
        campaign, truth = campaign_of(k + 1, noise, layout=place, loads=loads, **options)
        cycles = [
            replace(
                cycle,
                force=scale * cycle.force,
                weight=scale * cycle.weight,
                load=replace(cycle.load, added=scale * cycle.load.added),
            )
            for cycle in campaign
        ]
        made.append((replace(campaign, cycles=tuple(cycles)), truth))
    return [campaign for campaign, _ in made], [truth for _, truth in made]


def in_one(campaigns, numbers=(1, 2, 3)):
    """Return the cycles of a mirror whose segments these are; actuators in turn, not in blocks."""
    layouts = [campaign.layout for campaign in campaigns]
    segment = np.repeat(numbers[: len(layouts)], [one.n for one in layouts])
    mixed = np.random.default_rng(5).permutation(segment.size)

    def row(values):
        return np.concatenate(values, axis=-1)[..., mixed]

    whole = layout(
        row([one.x for one in layouts]),
        row([one.y for one in layouts]),
        nz=row([one.nz for one in layouts]),
        id=row([one.id for one in layouts]),
        enabled=row([one.enabled for one in layouts]),
        segment=segment[mixed],
    )
    made = []
    for cycles in zip(*campaigns, strict=True):
        own = tuple(
            Segment(number, c.weight, c.weight_error, c.load.added, c.load.added_error)
            for number, c in zip(numbers, cycles, strict=False)
        )
        sums = sums_of(own)
        load = replace(cycles[0].load, added=sums.pop("added"), added_error=sums.pop("added_error"))
        force = row([c.force for c in cycles])
        made.append(replace(cycles[0], layout=whole, load=load, force=force, segments=own, **sums))
    return made
