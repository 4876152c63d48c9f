"""Recovery: do fits of simulated robots find the truth? Robots and logs come from a simulator written apart."""
