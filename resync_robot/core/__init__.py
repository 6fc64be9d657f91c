"""Types that every other room shares. Imports numpy and small file formats only."""
