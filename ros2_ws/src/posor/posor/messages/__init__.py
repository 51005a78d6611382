"""Messages as bytes: layout, unpacking of raw scans, packing of estimates. No ROS here."""
