"""The calibration procedures, each a constant of a module; ``procedure_registry`` finds them."""
