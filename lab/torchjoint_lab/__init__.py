"""What research on torchjoint needs and its users do not: training, benchmarks, other methods, synthetic domains."""
