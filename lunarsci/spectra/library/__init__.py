"""Libraries of end-member spectra: reading, writing, describing and checking them."""

from lunarsci.spectra.library.end_member import CHEMISTRY, MINERALS, EndMember, read_library, to_ecsv

__all__ = ["CHEMISTRY", "MINERALS", "EndMember", "read_library", "to_ecsv"]
