# facts_damping with everything that `make demo` sets up, and the demo's results in results/demo.
#   docker build -t facts_damping .
#   docker run --rm -it facts_damping            a shell with the environment active
#   docker run --rm facts_damping make test      all checks and tests
FROM python:3.12-slim-bookworm
RUN apt-get update \
    && apt-get install -y --no-install-recommends gcc g++ git libc6-dev make \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /facts_damping
COPY . .
RUN make demo
ENV PATH=/facts_damping/.venv/bin:$PATH
CMD ["bash"]
