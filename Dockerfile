# snerg without a display: makes scenes from photographs, renders and measures packs.
#   docker build -t snerg .                                            on the processor
#   docker build -t snerg-cuda --build-arg EXTRAS=train-cuda12,video,poses,export .   with JAX for NVIDIA GPUs (docker run --gpus all)
#   docker run --rm -v "$PWD:/work" snerg make PHOTOS --out out/scene --no-view
FROM python:3.12-slim-bookworm AS build
WORKDIR /src
COPY pyproject.toml setup.py README.md LICENSE snerg_commands.py ./
COPY console console
COPY scenepack scenepack
COPY training training
COPY baker baker
COPY viewer viewer
COPY shaders shaders
COPY snerg snerg
RUN ["pip", "wheel", "--no-cache-dir", "--no-deps", "--wheel-dir", "/dist", "."]

FROM python:3.12-slim-bookworm
ARG EXTRAS=train,video,poses,export
# Mesa draws where no graphics card does; the versions are those of the distribution.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1 libgl1-mesa-dri libgomp1 \
    && rm -rf /var/lib/apt/lists/*
COPY constraints.txt /tmp/constraints.txt
COPY --from=build /dist /dist
RUN pip install --no-cache-dir --constraint /tmp/constraints.txt "$(ls /dist/snerg-*.whl)[${EXTRAS}]" \
    && useradd --uid 1000 --create-home snerg
USER 1000
WORKDIR /work
ENTRYPOINT ["python", "-m", "snerg"]
CMD ["--help"]
