"""What reports are made of: one self-contained page, the look of its figures, the command line that asks for it."""
