"""What every sweep uses: samples, solvers, the stressed stream, the sweep itself and the rows it makes."""
