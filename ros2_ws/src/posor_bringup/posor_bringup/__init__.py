"""The POSOR stack put together: the demo, its report, and the 1985 rig's description."""
