"""MuJoCo models, rollouts and gaits; observation and actor need numpy only and run on the robot too."""
