# Everything in one image, installed by the Makefile's own commands:
#   docker build -t ideal-robot .
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD/out:/ideal-robot/out" ideal-robot
# Nothing in it runs as root; --user has what is written belong to whoever starts it.
FROM python:3.11-slim
# Pinocchio's wheel needs OpenMP from the system, which the slim image does not have.
RUN apt-get update && apt-get install -y --no-install-recommends git libgomp1 make && rm -rf /var/lib/apt/lists/*
WORKDIR /ideal-robot
COPY . .
RUN make .venv/installed
ENV PATH=/ideal-robot/.venv/bin:$PATH HOME=/home/robot
# Compiled code is kept beside its source; whichever user runs it may add to it.
RUN useradd --create-home --home-dir /home/robot robot && mkdir -p out
RUN chown -R robot /ideal-robot && chmod -R a+rwX /home/robot /ideal-robot
USER robot
CMD ["make", "demo"]
