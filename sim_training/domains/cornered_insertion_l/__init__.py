"""Cornered Insertion-L: free a block under a lid, build a tower, and put it away in a drawer."""
