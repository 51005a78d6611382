"""From the joints' poses to the endpoint: arm file, beams, sag, time synchroniser."""
