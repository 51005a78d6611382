"""The program that tells an error budget: tables, files, a page with charts."""
