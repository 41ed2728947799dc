"""Study: diagnose logs of robots that nobody wrote by hand, simulated by MuJoCo."""
