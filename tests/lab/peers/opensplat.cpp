// Times OpenSplat's processor path on the Gaussians, camera and target that `dgs bench gradient` hands it. Built by
// `build-opensplat` beside this file; OpenSplat itself is under the AGPL and no part of this project.
//
//   opensplat INPUT RUNS OUTPUT
//
// INPUT, little endian: u32 count, width, height; f32 fx, fy, cx, cy; f32 world-to-camera matrix, 16, row by row (x
// right, y down, z forward); per Gaussian f32 position 3, scale 3, rotation w x y z, opacity, colour 3; f32 target,
// width x height x 3. Standard output: RUNS lines, milliseconds forward and of forward with all gradients of the mean
// squared error. OUTPUT: the picture over black, f32, width x height x 3.
#include "project_gaussians.hpp"
#include "rasterize_gaussians.hpp"

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <vector>

namespace {

constexpr int WARM_UP = 1;
constexpr float NEAR_PLANE = 0.01f, FAR_PLANE = 1000.0f;

template <typename T> std::vector<T> read(std::ifstream &file, size_t count) {
    std::vector<T> values(count);
    if (!file.read(reinterpret_cast<char *>(values.data()), count * sizeof(T)))
        throw std::runtime_error("the input ends early");
    return values;
}

torch::Tensor tensor(const std::vector<float> &values, at::IntArrayRef shape) {
    return torch::tensor(values).reshape(shape);
}

double milliseconds_since(std::chrono::steady_clock::time_point start) {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

} // namespace

int main(int argc, char **argv) try {
    if (argc != 4)
        throw std::runtime_error("usage: opensplat INPUT RUNS OUTPUT");
    std::ifstream file(argv[1], std::ios::binary);
    const auto sizes = read<uint32_t>(file, 3);
    const int64_t count = sizes[0], width = sizes[1], height = sizes[2];
    const auto lens = read<float>(file, 4);
    const auto view = tensor(read<float>(file, 16), {4, 4});
    const auto rows = tensor(read<float>(file, count * 14), {count, 14});
    const auto target = tensor(read<float>(file, width * height * 3), {height, width, 3});

    const auto columns = [&](int64_t from, int64_t to) {
        return rows.slice(1, from, to).contiguous().clone().set_requires_grad(true);
    };
    auto positions = columns(0, 3), scales = columns(3, 6), rotations = columns(6, 10);
    auto opacities = columns(10, 11), colours = columns(11, 14);
    const float across = 2.0f * lens[0] / width, down = 2.0f * lens[1] / height;
    const float depth = FAR_PLANE - NEAR_PLANE;
    const std::vector<float> projection = {
        across, 0, 2.0f * lens[2] / width - 1.0f, 0,
        0, down, 2.0f * lens[3] / height - 1.0f, 0,
        0, 0, (FAR_PLANE + NEAR_PLANE) / depth, -2.0f * FAR_PLANE * NEAR_PLANE / depth,
        0, 0, 1, 0,
    };
    auto view_matrix = view, projected = tensor(projection, {4, 4}).matmul(view);
    const auto background = torch::zeros({3});

    const auto draw = [&] {
        auto found = ProjectGaussiansCPU::apply(positions, scales, 1.0f, rotations, view_matrix, projected, lens[0],
                                                lens[1], lens[2], lens[3], height, width, NEAR_PLANE);
        return RasterizeGaussiansCPU::apply(found[0], found[1], found[2], colours, opacities, found[3], found[4],
                                            height, width, background);
    };
    const int runs = std::atoi(argv[2]);
    torch::Tensor picture;
    for (int run = -WARM_UP; run < runs; run++) {
        for (auto *values : {&positions, &scales, &rotations, &opacities, &colours})
            values->mutable_grad() = torch::Tensor();
        const auto start = std::chrono::steady_clock::now();
        picture = draw();
        const double forward = milliseconds_since(start);
        (picture - target).square().mean().backward();
        if (run >= 0)
            std::printf("%.4f %.4f\n", forward, milliseconds_since(start));
    }
    picture = picture.detach().contiguous();
    std::ofstream out(argv[3], std::ios::binary);
    out.write(reinterpret_cast<const char *>(picture.data_ptr<float>()), picture.numel() * sizeof(float));
    return out.good() ? 0 : 1;
} catch (const std::exception &error) {
    std::fprintf(stderr, "opensplat: %s\n", error.what());
    return 1;
}
