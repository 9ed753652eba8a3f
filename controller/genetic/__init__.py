"""Genetic planning: ordered directions and stops as chromosomes, in one stage or two (2025)."""
