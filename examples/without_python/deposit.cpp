// Share events among the cells around them on an NVIDIA GPU, without Python.
//
//   python -m evqr_kernels.export kernels --arch sm_90 --op deposit_events
//   g++ -std=c++17 -Ikernels -I/usr/local/cuda/include deposit.cpp -lcuda -o deposit
//   ./deposit kernels
#include <cuda.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "evqr_kernels.h"

static void check(CUresult result, const char *what) {
    if (result != CUDA_SUCCESS) {
        std::fprintf(stderr, "%s: CUDA error %d\n", what, int(result));
        std::exit(1);
    }
}

// An array of 4-byte numbers on the device, one after the other.
static evqr_array array_of(const std::vector<int32_t> &shape, const void *values) {
    evqr_array array = {};
    array.dimensions = uint16_t(shape.size());
    int32_t bytes = 4;
    for (size_t axis = shape.size(); axis-- > 0;) {
        array.shape[axis] = shape[axis];
        array.strides[axis] = bytes;
        bytes *= shape[axis];
    }
    CUdeviceptr memory;
    check(cuMemAlloc(&memory, size_t(bytes)), "cuMemAlloc");
    check(values ? cuMemcpyHtoD(memory, values, size_t(bytes)) : cuMemsetD8(memory, 0, size_t(bytes)), "copy");
    array.data = memory;
    return array;
}

// What `neighbours` in evqr_kernels/warp_backend/language.py makes: each entry begins a run of `count`.
static evqr_array neighbours(evqr_array array, int count) {
    array.shape[array.dimensions - 1] -= count - 1;
    return array;
}

int main(int argc, char **argv) {
    const evqr_launch *launch = EVQR_LAUNCHES;
    while (std::strcmp(launch->operation, "deposit_events") != 0) ++launch;

    CUdevice device;
    CUcontext context;
    CUmodule module;
    CUfunction kernel;
    check(cuInit(0), "cuInit");
    check(cuDeviceGet(&device, 0), "cuDeviceGet");
    check(cuDevicePrimaryCtxRetain(&context, device), "cuDevicePrimaryCtxRetain");
    check(cuCtxSetCurrent(context), "cuCtxSetCurrent");
    const std::string file = std::string(argc > 1 ? argv[1] : ".") + "/" + launch->file;
    check(cuModuleLoad(&module, file.c_str()), file.c_str());
    check(cuModuleGetFunction(&kernel, module, launch->entry), launch->entry);

    const int events = 1000, rows = 120, columns = 160;
    std::vector<float> x(events), y(events), t(events, 0.0f), weight(events, 1.0f);
    for (int e = 0; e < events; ++e) {
        x[e] = float(e % 150) + 0.25f;
        y[e] = float(e % 110) + 0.5f;
    }
    const int32_t window_ptr[] = {0, events};
    const float motion[] = {0.0f, 0.0f}, frame[] = {0.0f, 0.0f, 1.0f};
    evqr_array deposit = array_of({1, 2, rows, columns}, nullptr), pairs = neighbours(deposit, 2);
    evqr_array given[] = {
        array_of({events}, x.data()),      array_of({events}, y.data()),  array_of({events}, t.data()),
        array_of({events}, weight.data()), array_of({2}, window_ptr),     array_of({1, 2}, motion),
        array_of({1, 3}, frame),
    };

    // a thread takes 64 events, see evqr_kernels/operations/events.py
    const uint32_t threads = (events + 63) / 64;
    evqr_bounds_1 bounds = {{threads}, threads, 1};
    void *arguments[] = {&bounds,   &given[0], &given[1], &given[2], &given[3],
                         &given[4], &given[5], &given[6], &pairs};
    const unsigned blocks = (threads + EVQR_THREADS - 1) / EVQR_THREADS;
    check(cuLaunchKernel(kernel, blocks, 1, 1, EVQR_THREADS, 1, 1, 0, nullptr, arguments, nullptr), "launch");

    std::vector<float> cells(size_t(2) * rows * columns);
    check(cuMemcpyDtoH(cells.data(), deposit.data, 4 * cells.size()), "cuMemcpyDtoH");
    double sum = 0.0;
    for (float cell : cells) sum += cell;
    std::printf("%d events, %.1f in the cells\n", events, sum);
    return sum > events - 0.5 && sum < events + 0.5 ? 0 : 1;
}
