"""Units of the thesis that ``scipy.constants`` does not have, in SI units."""

from __future__ import annotations

from scipy.constants import inch, lbf, psi

UIN = 1e-6 * inch
KSI = 1e3 * psi
POUND_INCH = lbf * inch
INCH_OF_MERCURY = 3386.389
"""NIST SP 811, appendix B.8."""
