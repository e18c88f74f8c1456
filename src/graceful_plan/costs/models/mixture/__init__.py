"""Drop, spill and body together, weighted by how often what fails."""
