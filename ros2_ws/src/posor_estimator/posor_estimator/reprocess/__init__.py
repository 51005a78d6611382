"""From recorded raw scans to transforms and endpoint poses, without any node: what the nodes would have published."""
