"""lunarsci: what the rock is, what the ground is, and whether the next drive is safe.

Three subpackages, one per command group of the command line:

* `lunarsci.spectra`: reflectance spectra, absorption bands, the Modified Gaussian Model;
* `lunarsci.regolith`: wheel-soil forces and the identification of soil parameters;
* `lunarsci.twin`: a rocker-bogie rover on deformable terrain, and the safety of a planned drive.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"
