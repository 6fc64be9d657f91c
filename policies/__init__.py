"""Skills as they run: scripted ones that are given, neural ones that were learned."""
