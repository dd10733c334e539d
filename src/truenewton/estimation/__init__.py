"""The method: from commanded forces to alpha, B and torques, with their covariance.

Where the paper (Ricci, Riccardi and Zanotti 2008) stands in the code; D has no number there, it is
the system that follows eq. 3:

    eq. 1   sum f = -(P + B), and the torques    `truenewton.statics.arms`: `arms`, `external_load`
    eq. 2   f = alpha c                          `paper.equations`: `balance_rows`, into eq. 1
    eq. 3   C alpha = p, the bare mirror         `paper.equations`: `system_c`
    sec. 3  D alpha = q, with added weight Q     `paper.equations`: `system_d`
    eq. 4   E alpha' = r, B and torques unknown  `paper.equations`: `system_e`, `Unknowns`
    sec. 4  solution by SVD                      `paper.svd`: `solve`, `solve_campaign`
    sec. 4  the proof code                       `truenewton.studies.proof`: `prove`
    sec. 5  error over the cycles, E_CYCLE       `paper.svd`: `cycle_errors`

`svd` solves E, E_CYCLE solves C, and the proof solves both. `ml` uses sums over shapes instead.

Beyond the paper: maximum likelihood, with the noise in the readings (docs/likelihood.md). Each of
these packages and modules imports only those above it; docs/decisions.md lists the steps in the
order of the data:

    findings      findings, their sentences, and what every method returns
    readings      from rows to means, in two readings
    paper         the paper, equation by equation
    screening     rows left out; files whose load, unit, sign or labels are not what they claim
    likelihood    maximum likelihood itself
    matrix        relative alpha from a stiffness matrix alone
    problem       data, noise, unknowns and priors of a campaign; shapes that do not balance
    effects       bench effects that the model does not contain
    checks        stuck readings, exchanged columns, weights and dates that do not agree
    campaign_ml   `ml` on a campaign
    reciprocity   alpha, sensor gains and offsets from a stiffness that must be symmetric
"""
