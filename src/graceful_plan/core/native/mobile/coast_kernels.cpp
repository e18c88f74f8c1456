// The coast model for one instruction set. This file is compiled once per set, see target.hpp.
#include "mobile/coast/following.hpp"

namespace gp {
namespace GP_ISA {

static bool coast_hits(const CoastTables& of, const CoastState<double>& at, const std::vector<FloorShape>& shape,
                       const CoastQuery& query, CoastWork& work) {
  return Following(of, at, nullptr, query, work).all(shape);
}

static bool coast_hits_slopes(const CoastTables& of, const CoastState<Dual>& at, const std::vector<FloorShape>& shape,
                              const CoastQuery& query, CoastWork& work) {
  const CoastState<double> value{at.x.value(),     at.y.value(),    at.yaw.value(),   at.v.value(),
                                 at.omega.value(), at.time.value(), at.along.value(), at.across.value()};
  return Following(of, value, &at, query, work).all(shape);
}

}  // namespace GP_ISA

#define GP_JOIN_(a, b) a##b
#define GP_JOIN(a, b) GP_JOIN_(a, b)
extern const CoastKernels GP_JOIN(coast_kernels_, GP_ISA) = {
    .hits = GP_ISA::coast_hits,
    .hits_slopes = GP_ISA::coast_hits_slopes,
};

}  // namespace gp
