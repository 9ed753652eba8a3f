"""From records to tables, figures and reports. Never touches the simulation."""
