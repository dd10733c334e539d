"""The method: from commanded forces to alpha, B and torques, with their covariance.

Where the paper (Ricci, Riccardi and Zanotti 2008) stands in the code; D has no number there, it is
the system that follows eq. 3:

    eq. 1   sum f = -(P + B), and the torques    `statics.arms`: `arms`, `external_load`
    eq. 2   f = alpha c                          `systems`: `balance_rows`, which puts it into eq. 1
    eq. 3   C alpha = p, the bare mirror         `systems`: `system_c`
    sec. 3  D alpha = q, with added weight Q     `systems`: `system_d`
    eq. 4   E alpha' = r, B and torques unknown  `systems`: `system_e`; `unknowns`: `Unknowns`
    sec. 4  solution by SVD                      `cycles_svd`: `solve`; of a campaign, `find`
    sec. 4  the proof code                       `studies.proof`: `prove`
    sec. 5  error over the cycles, E_CYCLE       `cycle_errors`: `CycleErrors`

Beyond the paper: maximum likelihood, the noise where it is (docs/likelihood.md): `likelihood`. The
files, in the order in which data pass through them:

    unknowns         the order of the unknowns
    systems          the linear systems C, D, E
    cycles_svd       the paper's method: E alpha' = r by singular value decomposition
    cycle_errors     the paper's error: each cycle solved alone
    displaced_rows   rows of a cycle as they balance, displacements and gradients put to use
    block_rows       rows of a cycle in a block of groups, and what reads them
    block_sums       sums over such rows, here or by a cluster's workers
    repeats          rows by the group that they repeat, a block of groups after the other
    pooling          rows pooled over loads and signs: what shapes share besides repeats
    moments          repeats put together: number, mean, scatter
    file_labels      files whose load, SIGN or SHAPE is not what they say
    row_prints       prints of some rows
    files_apart      columns of a file that are not those of the others, told by them
    copied_files     files that are copies of others, told by them
    still_readings   readings that freeze, or end at a limit
    rounding_steps   forces in steps, and the noise that these add
    sifted           rows far from their repeats left out; what one reading of the rows leaves
    row_readers      the second reading of the rows, once for all who want to see them
    shape_sums       sums over shapes: what the likelihood needs of the means
    imbalance        what a reading is out of balance by, in terms of its noise
    multiple_tests   what chance alone does to one of many
    noise            of one reading: from repeats, as declared, or left to the fit
    structure        whether shapes repeat over loads and signs
    weights          errors of the weights, and the budget of the common scale
    problem          what the likelihood is asked: data, noise, unknowns, priors
    likelihood       maximum likelihood itself: score, information, minimisation
    outliers         shapes that do not balance
    minimum          what goes into the likelihood, and what comes out
    effects          what a bench does beside the model: named, and taken out where that cures
    seen_places      where actuators are seen to stand by what balances
    column_order     whether FORCE and POSITION stand in one order
    odd_actuators    readings that are stuck, coils without force, poles exchanged
    suspects         files, columns and actuators that may not be what they say
    fit_warnings     what is weak in a campaign and its fit
    cycles_ml        `ml` on a campaign
    reciprocity      alpha, sensor gains and offsets from a stiffness that must be symmetric
    stiffness_svd    relative alpha from a stiffness matrix, by its singular vectors
    stiffness_ml     `ml` on a stiffness matrix
    stiffness_columns  its columns in balance, each with the noise that it shows
    column_terms     what they leave and hold at one alpha
    column_noise     what that noise follows, chosen by the columns
    bad_sensors      sensors that read something else, told from actuators that push otherwise
    couplings        of actuators in a matrix: how large, how far, what pairs say of alpha
    matrix_order     whether it is a stiffness, lies the right way round, in the order of places
    matrix_faults    actuators of a matrix that do not fit, found and set free
    sifted_matrix    a matrix without them
    matrix_facts     symmetry and negative modes of a matrix
    coherent_imbalance  whether the imbalance of its columns is noise, or the pattern of a mistake
    population       what is not smooth in log alpha, as samples of one population
    undetermined     patterns of alpha that noise decides
    identifiability  what the data can and cannot fix
    findings         what was found: codes and levels, sentences, the record of a finding
    diagnosis        how well alpha is determined and how well the data fit, in records
    estimate         what every method hands over
"""
