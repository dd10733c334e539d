"""Stiffness modes, turbulence and dissipation: the modal basis of the optical loop.

measured_stiffness  commanded force per reading, by regression over the rows of a campaign
true_stiffness      true Newtons per true displacement; actuators off or slaved; static forces
plausibility        wrong sensors, negative modes, and the model of the mirror
bases               Zernike's and Karhunen and Loeve's bases on the actuators
turbulence          the wavefront of the atmosphere, in the pupil and on the mirror
modal_base          residual wavefront, forces and powers of the first N modes
findings            modal bases before and after calibration, and how they differ
file                the modal basis in files (docs/files.md)
figures             modes on the mirror, residual, power
summary             text for terminal and page, values for scripts
"""

import truenewton.modal.summary  # noqa: F401  # registers what its results can do
