"""Draw-wire length sensors for a POSOR: an example of a sensor type in a package of its own."""
