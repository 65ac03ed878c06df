"""What the studies add to `import facts_damping as fd`."""
