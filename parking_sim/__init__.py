"""Scenario, simulation loop, plants, batch runs and command line."""
