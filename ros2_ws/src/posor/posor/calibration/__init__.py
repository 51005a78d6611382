"""Calibration files: YAML in SI units, versioned, validated, with uncertainties, provenance and a content hash."""
