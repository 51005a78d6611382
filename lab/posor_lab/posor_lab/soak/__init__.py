"""A simulated arm live for a long time: scans, memory, descriptors and threads."""
