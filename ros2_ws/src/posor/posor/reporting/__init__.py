"""Building blocks of reports: self-contained HTML pages, figure style, command-line parser."""
