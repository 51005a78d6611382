"""Tables of other programs (CSV, Parquet, TDMS, MATLAB) as scans and references, by a map that the user writes."""
