# Sourced by the other scripts: one thread a process, no screen.
export OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
export MPLBACKEND=Agg MUJOCO_GL=${MUJOCO_GL:-egl}
