"""What the tests of all packages share: real programs in processes of their own, and a node that watches the graph."""
