# Everything in one image, installed by the Makefile's own commands:
#   docker build -t ideal-robot .
#   docker run --rm -v "$PWD/out:/ideal-robot/out" ideal-robot
FROM python:3.11-slim
# Pinocchio's wheel needs OpenMP from the system, which the slim image does not have.
RUN apt-get update && apt-get install -y --no-install-recommends git libgomp1 make && rm -rf /var/lib/apt/lists/*
WORKDIR /ideal-robot
COPY . .
RUN make .venv/installed
ENV PATH=/ideal-robot/.venv/bin:$PATH
CMD ["make", "demo"]
