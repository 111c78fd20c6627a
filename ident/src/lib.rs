//! What data says: compare, identify, diagnose and report.
