"""Concepts from recovery data: features, neural classifiers, operators, and the search that selects them."""
