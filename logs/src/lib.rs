//! What is remembered: MCAP, CSV and ULog records with units.
