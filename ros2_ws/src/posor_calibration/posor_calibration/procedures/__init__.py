"""The calibration procedures, one module each; ``procedure_registry`` lists them."""
