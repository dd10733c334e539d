"""Stiffness modes, turbulence and dissipation: the modal base of the optical loop.

measured_stiffness  commanded force per reading, by regression over the rows of a campaign
shape_products      the sums over shapes that it needs
actuator_roles      who is commanded, off or slaved; alpha and gains matched to them
true_stiffness      true Newtons per true displacement, statics put to use
static_force        what turbulence does not change: weight, bias, what holds the mirror flat
turbulence          the wavefront that the atmosphere sends
zernikes            Zernike polynomials as Noll orders them
pupil               where the mirror lies in the telescope's pupil
bases               Zernike's and Karhunen and Loeve's bases on the actuators
modal_base          stiffness modes, and what turbulence costs on three bases
dissipation         what the first N modes leave of the turbulence, and what they cost
comparison          how two sets of modes differ
findings            modal bases before and after calibration: the result
file                the modal base in files (docs/files.md)
figures             modes on the mirror, residual, power
words               in words and numbers: terminal, page, script
"""
