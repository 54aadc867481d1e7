"""What is known of the sheet on one deformation: by its scan, by how scans and sheets err, by what it reads at rest."""
